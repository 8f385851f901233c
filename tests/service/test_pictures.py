"""Pictures: what must be seen in them is there, whatever the map is like."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image as mpimage
from matplotlib.figure import Figure

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.render import ground_drawing
from joulemap.service.render.pictures import lattice_image, route_picture
from joulemap.service.render.raster_shading import INK, OPTIMAL, SHORTEST


def rough(rows: int = 30, cols: int = 40) -> Heightmap:
    """A knoll between two sides, a hole of unknown ground, and a bank too steep to climb in the north."""
    row, col = np.mgrid[0:rows, 0:cols]
    heights = 3.0 * np.exp(-((row - rows / 2) ** 2 + (col - cols / 2) ** 2) / 40.0)
    heights += np.where(row < 4, (4 - row) * 0.8, 0.0)
    heights[-6:-3, -8:-4] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(366_000.0, 4_064_500.0, 1.0, rows, cols, "EPSG:32630"))


@pytest.fixture(scope="module")
def lattice() -> CostLattice:
    return build_lattice(rough(), Robot(), PhysicsPredictor())


def pixels(png: bytes) -> np.ndarray:
    """(rows, cols, 3) 0..1."""
    return mpimage.imread(io.BytesIO(png), format="png")[..., :3]


def share_of(png: bytes, colour: str) -> float:
    """Share of pixels of a colour, #rrggbb."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return float((np.abs(pixels(png) - wanted).max(axis=2) < 0.02).mean())


@pytest.mark.parametrize(("view", "heading_deg"), [("mean", None), ("directionality", None), ("heading", 37.0)])
def test_every_view_is_drawn(lattice: CostLattice, view: str, heading_deg: float | None) -> None:
    png = lattice_image(lattice, view=view, heading_deg=heading_deg)
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    assert pixels(png).std() > 0.05


def test_what_is_too_steep_is_marked_where_it_blocks(lattice: CostLattice) -> None:
    """The bank climbs to the north at 0.8 m per metre (39 degrees): too steep along north, across for east."""
    grade, cross = (ground_drawing.REASONS[reason][0] for reason in (Blocked.GRADE, Blocked.CROSS_SLOPE))
    north, east = (lattice_image(lattice, view="heading", heading_deg=h) for h in (0.0, 90.0))
    assert share_of(north, grade) > 5.0 * share_of(east, grade)
    assert share_of(east, cross) > 5.0 * share_of(north, cross)


@pytest.mark.parametrize(("view", "heading_deg"), [("heading", None), ("heading", float("nan")), ("sideways", 3.0)])
def test_a_view_that_is_not_there_is_refused(lattice: CostLattice, view: str, heading_deg: float | None) -> None:
    with pytest.raises(InputError, match=r"heading_deg|sideways"):
        lattice_image(lattice, view=view, heading_deg=heading_deg)


def test_a_map_on_which_nothing_may_be_driven_is_still_drawn() -> None:
    steep = np.tile(np.arange(12, dtype=np.float32) * 3.0, (12, 1))
    lattice = build_lattice(Heightmap(steep, GridFrame(0.0, 12.0, 1.0, 12, 12)), Robot(), PhysicsPredictor())
    assert share_of(lattice_image(lattice), "#b3264a") > 0.2


def test_both_paths_are_in_the_picture() -> None:
    heightmap = rough()
    plan = RoutePlanner(build_lattice(heightmap, Robot(), PhysicsPredictor())).plan(
        (366_005.0, 4_064_485.0), (366_036.0, 4_064_484.0)
    )
    assert plan.saving_j > 0.0
    png = route_picture(heightmap, plan.route, plan.shortest, title="knoll")
    assert share_of(png, OPTIMAL) > 1e-3
    assert share_of(png, SHORTEST) > 1e-3
    with_another = route_picture(heightmap, plan.route, plan.route, title="knoll", alternatives=[plan.shortest])
    assert share_of(with_another, INK) > 1.2 * share_of(png, INK)  # its line


def test_what_is_blocked_in_some_headings_is_in_the_picture_of_a_path() -> None:
    heightmap = rough()
    sides = build_lattice(heightmap, Robot(max_grade_deg=50.0), PhysicsPredictor())  # the bank: too steep across only
    free = build_lattice(heightmap, Robot(max_grade_deg=50.0, max_cross_slope_deg=50.0), PhysicsPredictor())
    plan = RoutePlanner(free).plan((366_005.0, 4_064_485.0), (366_036.0, 4_064_484.0))
    label = "blocked in some headings"
    labels, pictures = [], []
    for ground in (sides, free):
        axes = Figure().add_subplot()
        labels.append([patch.get_label() for patch in ground_drawing.draw_lattice_ground(axes, ground)])
        pictures.append(pixels(route_picture(ground, plan.route, plan.shortest, title="bank")))
    assert label in labels[0]
    assert label not in labels[1]
    bank = [picture[60:150, 150:700].mean(axis=(0, 1)) for picture in pictures]
    assert bank[0][0] - bank[0][1] > bank[1][0] - bank[1][1] + 0.01  # redder


@pytest.mark.parametrize("shape", [(2, 2), (3, 200), (200, 3)])
def test_odd_shapes_are_drawn(shape: tuple[int, int]) -> None:
    flat = Heightmap(np.zeros(shape, dtype=np.float32), GridFrame(0.0, 50.0, 1.0, *shape))
    lattice = build_lattice(flat, Robot(), PhysicsPredictor())
    assert lattice_image(lattice).startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["$\\frac{", "r" * 200, "50 $ rover", "ü€漢"])
def test_any_name_of_a_robot_is_drawn(lattice: CostLattice, name: str) -> None:
    named = replace(lattice, robot=replace(lattice.robot, name=name))
    assert lattice_image(named).startswith(b"\x89PNG")
