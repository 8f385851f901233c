"""The lattice: parity with the predictor, blocked reasons, saving and exporting."""

import json
from io import BytesIO

import numpy as np
import pytest
import zarr

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import DamagedError, HeightmapError, InputError, NotFoundError, TooLargeError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.folder import save_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.npz import export_npz
from joulemap.planner.pricing.integrator import leg_prices

ROBOT = Robot(max_grade_deg=20.0, max_cross_slope_deg=15.0)
ACROSS_10_M, ALONG_8_M = np.array([[10.0, 7.0], [10.0, 13.0]]), np.array([[4.0, 7.5], [15.0, 7.5]])
"""Legs (row, col) from x = 7.5 to 13.5 m, and along x = 8 m."""


def surface(function, *, metres=20, resolution_m=0.25) -> Heightmap:
    side = round(metres / resolution_m)
    frame = GridFrame(1000.0, 2000.0 + metres, resolution_m, side, side, "EPSG:32630")
    x, y = np.meshgrid(*frame.centres())
    return Heightmap(np.asarray(function(x - 1000.0, y - 2000.0), dtype=np.float32), frame)


def rolling(x, y):
    return 0.4 * np.sin(0.6 * x) + 0.3 * np.cos(0.5 * y + 0.3 * x)


@pytest.mark.parametrize("spacing_m", [0.5, 1.0, 1.7])
def test_an_entry_is_the_predictors_answer_for_that_segment(spacing_m):
    heightmap = surface(rolling)
    source = PhysicsPredictor()
    lattice = build_lattice(heightmap, ROBOT, source, spacing_m=spacing_m, headings=8, tile_cells=3)
    x, y = (a.ravel() for a in np.meshgrid(*lattice.frame.centres()))
    free = lattice.blocked.ravel() == Blocked.FREE
    for k, heading in enumerate(heading_bins(8)):
        segment = source.segment_traction(heightmap, ROBOT, x[free], y[free], np.full(free.sum(), heading))
        np.testing.assert_allclose(lattice.traction_per_m[..., k].ravel()[free], segment, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(lattice.energy_per_m, ROBOT.price_per_m(lattice.traction_per_m), rtol=1e-6)


def test_gradient_of_a_plane_is_exact_and_limits_depend_on_heading():
    heightmap = surface(lambda x, y: 0.30 * y + 0.05 * x)  # 16.7 degrees to the north
    lattice = build_lattice(heightmap, ROBOT, PhysicsPredictor())
    np.testing.assert_allclose(lattice.gradient[..., 0], 0.05, atol=1e-5)
    np.testing.assert_allclose(lattice.gradient[..., 1], 0.30, atol=1e-5)
    codes = lattice.blocked_by_heading()
    assert (codes[..., 0] == Blocked.FREE).all()  # north: climbs 16.7 < 20, across 2.9 < 15
    assert (codes[..., 4] == Blocked.CROSS_SLOPE).all()  # east: across 16.7 > 15
    steep = build_lattice(surface(lambda x, y: 0.5 * y), ROBOT, PhysicsPredictor()).blocked_by_heading()
    assert (steep[..., 0] == Blocked.GRADE).all()
    assert (steep[..., 8] == Blocked.GRADE).all()  # down, too
    assert sum(lattice.blocked_shares().values()) == pytest.approx(1.0)


def test_a_step_higher_than_the_wheel_radius_blocks_and_a_lower_one_does_not():
    radius = ROBOT.wheel_radius_m
    for resolution_m in (0.05, 0.1, 0.2):
        for height, blocked in ((0.95 * radius, False), (1.05 * radius, True), (-1.05 * radius, True)):
            for edge_m in (10.0, 10.3):  # on the line between two cells, and inside one
                kerb = surface(
                    lambda x, y, height=height, edge_m=edge_m: 0.1 * y + np.where(x > edge_m, height, 0.0),
                    resolution_m=resolution_m,
                )
                lattice = build_lattice(kerb, ROBOT, PhysicsPredictor())
                across, along = (np.isnan(leg_prices(lattice, leg)) for leg in (ACROSS_10_M, ALONG_8_M))
                assert across[0] == blocked
                assert not along[0]
                if edge_m == 10.3:  # under the cells whose middle is at 10.5 m
                    assert (lattice.blocked[:, 10] == (Blocked.OBSTACLE if blocked else Blocked.FREE)).all()
                assert (lattice.blocked[:, [*range(9), *range(12, 20)]] == Blocked.FREE).all()


@pytest.mark.parametrize("resolution_m", [0.1, 0.2, 0.25])
@pytest.mark.parametrize("inside", [0.0, 0.3, 0.5, 0.8])
def test_a_kerb_inside_a_cell_is_a_step_on_a_survey_of_mean_heights(resolution_m, inside):
    count = round(20.0 / resolution_m)
    covered = np.clip(np.arange(count) + 1.0 - count / 2 - inside, 0.0, 1.0)  # share of each column above the kerb
    heights = np.tile(1.5 * ROBOT.wheel_radius_m * covered, (count, 1)).astype(np.float32)
    kerb = Heightmap(heights, GridFrame(0.0, 20.0, resolution_m, count, count))
    lattice = build_lattice(kerb, ROBOT, PhysicsPredictor())
    assert np.isnan(leg_prices(lattice, ACROSS_10_M))[0]
    assert not np.isnan(leg_prices(lattice, ALONG_8_M))[0]


def test_a_steep_slope_is_not_a_step_and_a_thin_wall_is():
    slope = build_lattice(surface(lambda x, y: 0.8 * np.abs(x - 10.0), resolution_m=0.1), ROBOT, PhysicsPredictor())
    assert (slope.blocked == Blocked.FREE).all()  # its grade is judged by heading
    wall = surface(lambda x, y: np.where(np.abs(x - 10.25) < 0.05, 0.3, 0.0), resolution_m=0.1)
    assert (build_lattice(wall, ROBOT, PhysicsPredictor()).blocked[:, 10] == Blocked.OBSTACLE).all()


def test_a_post_is_a_step_on_a_coarse_map_too_and_a_gentle_mound_is_not():
    for height, blocked in ((9.0, True), (-0.8, True), (0.1, False)):
        heights = np.zeros((20, 20), dtype=np.float32)
        heights[8, 11] = height
        lattice = build_lattice(Heightmap(heights, GridFrame(0.0, 20.0, 1.0, 20, 20)), ROBOT, PhysicsPredictor())
        assert lattice.blocked[8, 11] == (Blocked.STEP if blocked else Blocked.FREE)
        assert (lattice.blocked[:6] == Blocked.FREE).all()


def test_unknown_ground_blocks_every_square_metre_that_meets_it_and_nothing_else():
    heights = np.zeros((80, 80), dtype=np.float32)
    heights[42, 30] = np.nan  # row 42 at 0.25 m: y = 20 - 10.625; col 30: x = 7.625
    heightmap = Heightmap(heights, GridFrame(0.0, 20.0, 0.25, 80, 80))
    blocked = build_lattice(heightmap, ROBOT, PhysicsPredictor()).blocked
    assert blocked[10, 7] == Blocked.UNKNOWN
    unknown = np.argwhere(blocked == Blocked.UNKNOWN)
    assert (np.abs(unknown - [10, 7]) <= 1).all()
    assert ((blocked == Blocked.FREE) | (blocked == Blocked.UNKNOWN)).all()


def test_cells_whose_square_metre_leaves_the_map_are_outside():
    lattice = build_lattice(surface(rolling), ROBOT, PhysicsPredictor(), spacing_m=0.5)
    assert (lattice.blocked[0] == Blocked.OUTSIDE).all()
    assert (lattice.blocked[:, -1] == Blocked.OUTSIDE).all()
    assert (lattice.blocked[1:-1, 1:-1] != Blocked.OUTSIDE).all()


def test_saved_and_loaded_it_is_the_same(tmp_path):
    lattice = build_lattice(surface(rolling), ROBOT, PhysicsPredictor())
    save_lattice(lattice, tmp_path / "a.zarr")
    save_lattice(lattice, tmp_path / "a.zarr")  # again, over itself
    back = load_lattice(tmp_path / "a.zarr")
    for name in ("traction_per_m", "elevation_m", "gradient", "blocked"):
        np.testing.assert_array_equal(getattr(back, name), getattr(lattice, name))
    assert back.frame == lattice.frame
    assert back.robot == lattice.robot
    assert back.provenance == json.loads(json.dumps(lattice.provenance))
    assert back.provenance["model"]["name"] == "physics"


def test_what_is_not_a_lattice_is_refused(tmp_path):
    with pytest.raises(NotFoundError) as caught:
        load_lattice(tmp_path / "nowhere.zarr")
    assert caught.value.message == f"there is no cost map {tmp_path / 'nowhere.zarr'}"
    (tmp_path / "mine").mkdir()
    with pytest.raises(InputError, match="not a cost lattice"):
        load_lattice(tmp_path / "mine")
    (tmp_path / "mine" / "precious.txt").write_text("keep")
    with pytest.raises(InputError, match="will not be overwritten"):
        save_lattice(build_lattice(surface(rolling), ROBOT, PhysicsPredictor()), tmp_path / "mine")
    assert (tmp_path / "mine" / "precious.txt").read_text() == "keep"
    zarr.open_group(tmp_path / "other.zarr", mode="w").create_array("precious", data=np.arange(3))
    with pytest.raises(InputError, match="will not be overwritten"):
        save_lattice(build_lattice(surface(rolling), ROBOT, PhysicsPredictor()), tmp_path / "other.zarr")
    assert zarr.open_group(tmp_path / "other.zarr", mode="r")["precious"][2] == 2
    save_lattice(build_lattice(surface(rolling), ROBOT, PhysicsPredictor()), tmp_path / "b.zarr")
    for chunk in (tmp_path / "b.zarr" / "gradient").rglob("*"):
        if chunk.is_file():
            chunk.unlink()
    with pytest.raises(DamagedError, match=r"b\.zarr/gradient/zarr\.json: it is missing"):
        load_lattice(tmp_path / "b.zarr")
    save_lattice(build_lattice(surface(rolling), ROBOT, PhysicsPredictor()), tmp_path / "b.zarr")  # made again
    assert load_lattice(tmp_path / "b.zarr").headings == 16


def test_exports_hold_the_prices_and_what_is_blocked():
    lattice = build_lattice(surface(lambda x, y: 0.3 * y), ROBOT, PhysicsPredictor(), headings=8)
    saved = np.load(BytesIO(export_npz(lattice)))
    np.testing.assert_array_equal(saved["energy_per_m"], lattice.energy_per_m)
    np.testing.assert_array_equal(saved["blocked"], lattice.blocked_by_heading())


def test_settings_outside_their_limits_are_named():
    heightmap = surface(rolling)
    with pytest.raises(InputError, match=r"4\.\.360"):
        build_lattice(heightmap, ROBOT, PhysicsPredictor(), headings=3)
    with pytest.raises(TooLargeError, match=r"larger spacing than.*joulemap costmap"):
        build_lattice(heightmap, ROBOT, PhysicsPredictor(), spacing_m=0.002)
    with pytest.raises(HeightmapError, match="too small"):
        build_lattice(heightmap, ROBOT, PhysicsPredictor(), spacing_m=15.0)
    lattice = build_lattice(heightmap, ROBOT, PhysicsPredictor())
    with pytest.raises(InputError, match="gradient"):
        CostLattice(
            lattice.frame, ROBOT, lattice.traction_per_m, lattice.elevation_m, lattice.gradient[:3], lattice.blocked
        )
