"""What Python users already have is taken: shapely, GeoPandas, masks, xarray; maps are copied; names are hinted at."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import joulemap as jm
from joulemap.model.errors import HeightmapError, InputError, RobotError
from joulemap.planner.lattice import Blocked

shapely = pytest.importorskip("shapely.geometry")
WEST, NORTH, ROWS, COLS = 500_000.0, 4_000_030.0, 30, 40
START, GOAL = (WEST + 2.5, NORTH - 15.5), (WEST + 37.5, NORTH - 15.5)


@pytest.fixture(scope="module")
def ground() -> jm.Heightmap:
    heights = np.zeros((ROWS, COLS))
    heights[:, 20:] += np.linspace(0.0, 1.0, 20)
    return jm.heightmap(heights, resolution_m=1.0, west_m=WEST, north_m=NORTH, crs="EPSG:32630")


@pytest.fixture(scope="module")
def flat(ground: jm.Heightmap) -> jm.CostMap:
    return jm.costmap(ground, model="physics")


def _avoided(costs: jm.CostMap, areas: Any) -> np.ndarray:
    """Cells that only the question blocks."""
    from joulemap.service.places.places import Places

    lattice = costs.planner.avoiding(Places(costs.lattice.frame).areas(areas)).lattice
    return (lattice.blocked_by_heading() != Blocked.FREE).all(axis=2) & ~(
        costs.lattice.blocked_by_heading() != Blocked.FREE
    ).all(axis=2)


BOX = shapely.box(WEST + 15.2, NORTH - 25.2, WEST + 18.8, NORTH - 8.2)


def test_polygons_of_all_kinds_block_the_same(flat: jm.CostMap) -> None:
    geopandas = pytest.importorskip("geopandas")
    expected = _avoided(flat, [list(BOX.exterior.coords)])
    assert expected.sum() > 20
    table = geopandas.GeoDataFrame(geometry=[BOX], crs="EPSG:32630")
    for areas in (BOX, [BOX], shapely.MultiPolygon([BOX]), table, table.geometry, table.to_crs("EPSG:4326")):
        assert (_avoided(flat, areas) == expected).mean() > 0.995  # degrees bend straight edges a little
    route = flat.plan(START, GOAL, avoid=table)
    assert not shapely.LineString(route.points).intersects(BOX)
    assert route.energy_j > flat.plan(START, GOAL).energy_j


def test_a_hole_stays_open(flat: jm.CostMap) -> None:
    ring = BOX.buffer(3.0).difference(BOX.buffer(1.0))
    found = _avoided(flat, ring)
    assert not found[16, 17], "its middle"
    assert found.sum() > 40


def test_a_mask_blocks_its_cells_alone(flat: jm.CostMap) -> None:
    mask = np.zeros((ROWS, COLS), dtype=bool)
    mask[5:25, 18:21] = mask[10:12, 10:30] = True
    assert (_avoided(flat, mask) == mask).all()
    with pytest.raises(InputError, match="30 x 40"):
        flat.plan(START, GOAL, avoid=mask[:-1])


def test_a_line_is_no_area(flat: jm.CostMap) -> None:
    with pytest.raises(InputError, match="buffer"):
        flat.plan(START, GOAL, avoid=shapely.LineString([START, GOAL]))


@pytest.mark.parametrize("up", [True, False])
def test_a_data_array_keeps_its_place(ground: jm.Heightmap, up: bool) -> None:
    y = NORTH - 0.5 - np.arange(ROWS)
    array = xarray.DataArray(
        ground.heights, coords={"y": y, "x": WEST + 0.5 + np.arange(COLS)}, dims=("y", "x"), name="elevation"
    ).assign_coords(spatial_ref=xarray.DataArray(0, attrs={"crs_wkt": _wkt()}))
    array = array[::-1] if up else array
    made = jm.heightmap(array)
    assert made.frame == ground.frame
    assert np.array_equal(made.heights, ground.heights)
    assert jm.costmap(array, model="physics").bounds == ground.frame.bounds
    with pytest.raises(HeightmapError, match="leave out"):
        jm.heightmap(array, resolution_m=1.0)
    with pytest.raises(HeightmapError, match="square"):
        jm.heightmap(array.isel(x=slice(None, None, 2)))


def _wkt() -> str:
    from rasterio.crs import CRS

    return str(CRS.from_epsg(32630).to_wkt())


@pytest.mark.parametrize("made", [copy.copy, copy.deepcopy, lambda costs: pickle.loads(pickle.dumps(costs))])
def test_maps_are_copied(flat: jm.CostMap, tmp_path: Path, made: Any) -> None:
    expected = flat.plan(START, GOAL).energy_j
    assert made(flat).plan(START, GOAL).energy_j == expected
    stored = jm.open_costmap(flat.save(tmp_path / "map.zarr") or tmp_path / "map.zarr", memory_gb=0.5)
    assert made(stored).plan(START, GOAL).energy_j == pytest.approx(expected, rel=1e-6)


def test_a_wrong_name_of_a_robot_is_hinted_at() -> None:
    with pytest.raises(RobotError, match="did you mean mass_kg"):
        jm.Robot(mass=3)  # type: ignore[call-arg]
    assert copy.deepcopy(jm.Robot(mass_kg=3.0)) == pickle.loads(pickle.dumps(jm.Robot(mass_kg=3.0)))


def test_a_data_array_without_coordinates_is_an_array() -> None:
    heights = np.arange(12.0).reshape(3, 4)
    plain = xarray.DataArray(heights, dims=("y", "x"))
    with pytest.raises(HeightmapError, match="give resolution_m"):
        jm.heightmap(plain)
    made = jm.heightmap(plain, resolution_m=0.5)
    np.testing.assert_array_equal(made.heights, heights)
    assert made.resolution_m == 0.5


def test_what_a_data_array_declares_of_its_values_holds() -> None:
    heights = np.ones((3, 4))
    heights[1, 2] = -9999.0
    where = {"y": [2.5, 1.5, 0.5], "x": [0.5, 1.5, 2.5, 3.5]}
    given = xarray.DataArray(heights, coords=where, dims=("y", "x"), attrs={"_FillValue": -9999.0, "units": "m"})
    assert np.isnan(jm.heightmap(given).heights).sum() == 1
    with pytest.raises(HeightmapError, match="heights in 'feet': convert them"):
        jm.heightmap(given.assign_attrs(units="feet"))
    with pytest.raises(HeightmapError, match=r"with the scale 0\.01"):
        jm.heightmap(given.assign_attrs(scale_factor=0.01))


@pytest.mark.parametrize("seed", [-5, 10**30])
def test_a_seed_that_no_sampler_takes_is_refused(flat: jm.CostMap, seed: int) -> None:
    with pytest.raises(InputError, match=r"seed: Input should be (greater|less) than or equal to (0|2147483647), got"):
        flat.plan(START, GOAL, planner="bitstar", seed=seed, time_limit_s=0.1)
