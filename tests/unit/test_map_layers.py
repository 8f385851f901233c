"""Layers of the page: coarse maps of those that are too large, colours that mean what the scale says."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import NotFoundError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.folder import save_lattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.service.render import map_pieces, raster_shading
from joulemap.service.render.map_layers import (
    blocked_layer,
    coarse_heights,
    colour_scale,
    energy_layer,
    ground_layer,
    layer_bounds,
    overview,
)
from joulemap.service.render.map_pieces import draw_piece, levels_of, look_of, roses


def wavy(rows: int = 30, cols: int = 47) -> Heightmap:
    row, col = np.mgrid[0:rows, 0:cols]
    heights = np.sin(row / 5.0) + np.cos(col / 7.0)
    heights[4:9, 20:26] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(100.0, 200.0, 1.0, rows, cols))


@pytest.fixture(scope="module")
def lattice() -> CostLattice:
    return build_lattice(wavy(), Robot(), PhysicsPredictor())


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"), dtype=float) / 255.0


def test_a_coarse_map_has_the_cells_in_the_middle(
    lattice: CostLattice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raster_shading, "MAX_PIXELS", 16)  # squares of three cells
    save_lattice(lattice, tmp_path / "map.zarr")
    coarse = overview(StoredLattice(tmp_path / "map.zarr"))
    assert coarse.frame.shape == (10, 15)
    assert coarse.frame.bounds == layer_bounds(lattice.frame) == (100.0, 170.0, 145.0, 200.0)
    np.testing.assert_array_equal(coarse.traction_per_m, lattice.traction_per_m[1:30:3, 1:45:3])
    np.testing.assert_array_equal(coarse.blocked, lattice.blocked[1:30:3, 1:45:3])


@pytest.mark.parametrize("strip", [1, 10_000])
def test_coarse_heights_are_the_means_whatever_is_read_at_a_time(strip: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster_shading, "MAX_PIXELS", 16)
    monkeypatch.setattr("joulemap.service.render.map_layers._STRIP_CELLS", strip)
    ground = wavy()
    heights, extent = coarse_heights(ground)
    whole, same = raster_shading.thinned(ground.heights, ground.frame)
    np.testing.assert_allclose(heights, whole, rtol=1e-6)
    assert extent == same


def test_dearer_cells_are_darker_and_blocked_ones_are_transparent(lattice: CostLattice) -> None:
    image = pixels(energy_layer(lattice))
    free = (lattice.blocked_by_heading() == Blocked.FREE).any(axis=2)
    np.testing.assert_array_equal(image[..., 3] > 0.0, free)
    price = lattice.mean_energy_per_m()
    low, high = np.nanquantile(price, [0.1, 0.9])
    darkness = 1.0 - image[..., :3].mean(axis=2)
    assert darkness[free & (price > high)].mean() > 2.0 * darkness[free & (price < low)].mean()
    least, most = colour_scale(lattice, "mean")
    assert 0.999 * np.nanmin(price) < least < low < high < most < 1.001 * np.nanmax(price)


def test_ground_and_blocked_ground_are_seen_where_they_are(lattice: CostLattice) -> None:
    times = 900 // 47
    known = pixels(ground_layer(lattice.elevation_m, lattice.frame.bounds))[..., 3] == 1.0
    np.testing.assert_array_equal(known[::times, ::times], np.isfinite(lattice.elevation_m))
    hatched = pixels(blocked_layer(lattice))[..., 3] > 0.5
    blocked = (lattice.blocked_by_heading() != Blocked.FREE).all(axis=2)
    np.testing.assert_array_equal(hatched[::times, ::times], blocked)


def test_roses_are_those_of_the_cells_in_the_part(lattice: CostLattice) -> None:
    found = roses(lattice, (103.0, 190.0, 109.0, 197.0), across=3)
    assert found["points"] == [[104.5, 195.5], [107.5, 195.5], [104.5, 192.5], [107.5, 192.5]]
    row, col = lattice.frame.cell_of(107.5, 192.5)
    assert found["energy_per_m"][3] == pytest.approx(lattice.energy_per_m[row, col].tolist())
    assert roses(lattice, (0.0, 0.0, 1.0, 1.0), across=3)["points"] == []


@pytest.mark.parametrize("level", [0, 1])
def test_pieces_join_without_a_seam(
    level: int, lattice: CostLattice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pieces beside each other are the picture of the whole, from memory as from disk."""
    monkeypatch.setattr(raster_shading, "MAX_PIXELS", 16)
    save_lattice(lattice, tmp_path / "map.zarr")
    stored, look, step = StoredLattice(tmp_path / "map.zarr"), look_of(lattice), 2**level
    assert levels_of(lattice.frame.shape) == 2
    whole = pixels(draw_piece(lattice, look, (level, 0, 0), view="mean"))
    assert whole.shape[:2] == tuple(n // step for n in lattice.frame.shape)
    monkeypatch.setattr(map_pieces, "PIECE_PIXELS", 8)  # as wide as the pattern of a hatch
    rows, cols = (-(-n // step // 8) for n in lattice.frame.shape)
    for one in (lattice, stored):
        pieces = [
            np.hstack([pixels(draw_piece(one, look, (level, row, col), view="mean")) for col in range(cols)])
            for row in range(rows)
        ]
        np.testing.assert_array_equal(np.vstack(pieces), whole)


def test_a_piece_that_is_not_there(lattice: CostLattice, monkeypatch: pytest.MonkeyPatch) -> None:
    look = look_of(lattice)
    assert levels_of(lattice.frame.shape) == 0
    for place in ((0, 0, 0), (0, -1, 0)):
        with pytest.raises(NotFoundError, match="no piece"):
            draw_piece(lattice, look, place, view=None)
    monkeypatch.setattr(raster_shading, "MAX_PIXELS", 16)
    with pytest.raises(NotFoundError, match="no piece 0, 1 of level 0"):
        draw_piece(lattice, look, (0, 0, 1), view=None)
