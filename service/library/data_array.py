"""Heights of a DataArray of xarray, as rioxarray and CF files have them: coordinates, CRS, direction of rows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.decoded import SAME_LENGTH

_ACROSS, _ALONG = ("x", "easting", "projection_x_coordinate"), ("y", "northing", "projection_y_coordinate")
_METRES = ("m", "metre", "metres", "meter", "meters", "")
_CRS_NAMES = ("spatial_ref", "crs_wkt", "crs")


class Grid(NamedTuple):
    """Heights with row 0 in the north, and where they lie."""

    heights: NDArray[np.float64]
    resolution_m: float
    west_m: float
    north_m: float
    crs: str | None


def says_where(array: Any) -> bool:
    """Whether an object is a DataArray with coordinates of both axes; without them it is an array."""
    if not (hasattr(array, "dims") and hasattr(array, "coords")):  # in this order: polygons of shapely fail at `coords`
        return False
    return all(any(name in array.coords for name in names) for names in (_ACROSS, _ALONG))


def nodata_of(array: Any) -> float | None:
    """What a DataArray declares as the mark of unknown heights, as rioxarray and CF files do."""
    declared = (
        array.encoding.get("_FillValue"),
        *(array.attrs.get(n) for n in ("_FillValue", "missing_value", "nodata")),
    )
    return next((float(value) for value in declared if value is not None), None)


def refuse_other_units(array: Any) -> None:
    """Refuse heights that a DataArray declares in another unit than metres, or scaled."""
    unit = str(array.attrs.get("units", "m")).strip().lower()
    if unit not in _METRES:
        raise HeightmapError(f"the DataArray has heights in {unit!r}: convert them to metres", unit=unit)
    scale, offset = (
        float(array.attrs.get(name, usual)) for name, usual in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    if (scale, offset) != (1.0, 0.0):
        raise HeightmapError(
            f"the DataArray is stored with the scale {scale:g} and the offset {offset:g}: decode it "
            "(`xarray.decode_cf`, or `mask_and_scale=True`)"
        )


def grid_of(array: Any) -> Grid:
    """Return what a DataArray says. Raises HeightmapError where its cells are not square and of one size."""
    array = array.squeeze(drop=False)
    across, along = (next((name for name in names if name in array.dims), None) for names in (_ACROSS, _ALONG))
    if array.ndim != 2 or across is None or along is None:
        raise HeightmapError(f"the DataArray has the dimensions {', '.join(map(str, array.dims))}: give y and x")
    x, y = (np.asarray(array[name].values, dtype=np.float64) for name in (across, along))
    heights = np.asarray(array.transpose(along, across).values, dtype=np.float64)
    if x.size < 2 or y.size < 2:
        raise HeightmapError("the DataArray has less than two rows or columns")
    steps = np.concatenate([np.abs(np.diff(x)), np.abs(np.diff(y))])
    step = float(np.median(steps))
    if np.abs(steps - step).max() > SAME_LENGTH * step:
        raise HeightmapError(
            f"the steps between the coordinates of the DataArray are {steps.min():g} to {steps.max():g} m: a "
            "heightmap has square cells",
            steps=[float(steps.min()), float(steps.max())],
        )
    heights = heights[:: 1 if y[0] > y[-1] else -1, :: 1 if x[0] < x[-1] else -1]
    return Grid(heights, step, float(x.min()) - step / 2, float(y.max()) + step / 2, _crs_of(array))


def _crs_of(array: Any) -> str | None:
    """The CRS as CF and rioxarray write it: in the attributes of the array, or of the variable that they name."""
    mapping = array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref"))
    places = [array.coords[mapping].attrs] if mapping in array.coords else []
    for attributes in (*places, array.attrs):
        for name in _CRS_NAMES:
            if attributes.get(name):
                return str(attributes[name])
    return None
