"""A cost lattice in xarray: opened from disk without a warning, and made of one in memory, with names and units."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import rasterio
import xarray as xr
import zarr

from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.folder import LatticeFolder, save_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.planner.lattice.xarray_dataset import lattice_dataset
from tests.reference.lattices import plane_lattice


def slope(crs: str | None = "EPSG:32630") -> CostLattice:
    """7 x 5 cells of 2 m, 0.4 m/m up to the north: too steep for headings along it; one cell is unknown."""
    robot = Robot(name="rover", max_grade_deg=15.0, max_cross_slope_deg=30.0)
    lattice = plane_lattice(7, 5, 0.0, 0.4, robot=robot, spacing_m=2.0, headings=8)
    blocked = lattice.blocked.copy()
    blocked[3, 2] = Blocked.UNKNOWN
    std = np.full(lattice.traction_per_m.shape, 3.0, dtype=np.float32)
    frame = replace(lattice.frame, west_m=500_000.0, north_m=4_000_014.0, crs=crs)
    return replace(lattice, frame=frame, blocked=blocked, std_j=std, provenance={"model": {"name": "physics"}})


def opened(path) -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return xr.open_zarr(path).load()


def test_a_lattice_on_disk_opens_in_xarray_with_names_coordinates_and_units(tmp_path):
    lattice = slope()
    save_lattice(lattice, tmp_path / "a.zarr")
    data = opened(tmp_path / "a.zarr")
    assert data.traction_per_m.dims == ("y", "x", "heading")
    assert data.gradient.dims == ("y", "x", "component")
    assert data.blocked.dims == data.elevation_m.dims == ("y", "x")
    for name in ("traction_per_m", "elevation_m", "gradient", "blocked", "std_j"):
        np.testing.assert_array_equal(data[name], getattr(lattice, name))
        assert data[name].attrs["units"]
        assert data[name].attrs["long_name"]
        assert data[name].attrs["grid_mapping"] == "spatial_ref"
    np.testing.assert_array_equal(data.x, 500_001.0 + 2.0 * np.arange(5))  # cell centres
    np.testing.assert_array_equal(data.y, 4_000_013.0 - 2.0 * np.arange(7))
    np.testing.assert_allclose(data.heading, 45.0 * np.arange(8))
    assert data.x.attrs["units"] == data.y.attrs["units"] == "m"
    assert data.heading.attrs["units"] == "degree"
    at = data.blocked.attrs
    meaning = dict(zip(at["flag_values"], at["flag_meanings"].split(), strict=True))
    assert meaning == {int(reason): reason.label for reason in Blocked}
    assert meaning[int(data.blocked.sel(x=500_005.0, y=4_000_007.0))] == "unknown"
    assert rasterio.crs.CRS.from_wkt(data.spatial_ref.attrs["crs_wkt"]).to_epsg() == 32630
    assert set(data.coords) == {"x", "y", "heading", "component", "spatial_ref"}


def test_unknown_is_a_code_and_no_missing_value(tmp_path):
    """The fill value of `blocked` is a code: whoever opens the file must see it, not NaN."""
    folder = LatticeFolder(tmp_path / "a.zarr")
    folder.lay_out(Tiling(slope(crs=None).frame, 8, 4), Robot(), with_std=False)
    folder.finish({})
    data = opened(tmp_path / "a.zarr")
    assert data.blocked.dtype == np.uint8
    assert (data.blocked == Blocked.UNKNOWN).all()
    assert "spatial_ref" not in data.variables
    assert "std_j" not in data


def test_a_folder_from_before_there_were_names_still_loads(tmp_path):
    lattice = slope()
    save_lattice(lattice, tmp_path / "new.zarr")
    new = zarr.open_group(tmp_path / "new.zarr", mode="r")
    old = zarr.open_group(tmp_path / "old.zarr", mode="w")
    for name in ("traction_per_m", "elevation_m", "gradient", "blocked", "std_j"):
        old.create_array(name, data=new[name][:])
    kept = ("format", "frame", "robot", "blocked_codes", "units", "provenance")  # all that there was
    old.attrs.update({name: new.attrs[name] for name in kept})
    assert old.attrs["format"] == "joulemap.cost-lattice/1"
    back = load_lattice(tmp_path / "old.zarr")
    np.testing.assert_array_equal(back.traction_per_m, lattice.traction_per_m)
    np.testing.assert_array_equal(back.blocked, lattice.blocked)
    assert (back.frame, back.robot) == (lattice.frame, lattice.robot)


def test_a_dataset_has_prices_that_are_nan_where_a_heading_is_blocked():
    lattice = slope()
    data = lattice_dataset(lattice)
    assert data.energy_per_m.dims == data.blocked.dims == data.std_j.dims == ("y", "x", "heading")
    assert data.energy_per_m.attrs["units"] == "J m-1"
    east, north = data.sel(heading=90.0), data.sel(heading=0.0)
    assert np.isnan(north.energy_per_m).all()  # 21.8 degrees up, the limit is 15
    assert (north.blocked.values[0] == Blocked.GRADE).all()
    assert int(np.isnan(east.energy_per_m).sum()) == 1  # the unknown cell; along the contour all others are free
    np.testing.assert_allclose(east.energy_per_m.values[0], lattice.robot.price_per_m(lattice.traction_per_m[0, :, 2]))
    assert float(data.elevation_m.sel(y=4_000_013.0, x=500_001.0)) == pytest.approx(0.4 * 13.0)
    assert json.loads(data.attrs["provenance"]) == lattice.provenance
    assert Robot.from_mapping(json.loads(data.attrs["robot"])) == lattice.robot
    assert "std_j" not in lattice_dataset(plane_lattice(4, 4, robot=Robot()))


def test_a_dataset_can_be_written_to_zarr_and_read_again(tmp_path):
    data = lattice_dataset(slope())
    data.to_zarr(tmp_path / "d.zarr", consolidated=False, zarr_format=3)
    back = xr.open_zarr(tmp_path / "d.zarr", consolidated=False, decode_coords="all").load()
    xr.testing.assert_equal(back, data)
