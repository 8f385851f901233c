"""Heightmaps and robots as Python users give them: a file, an array, a DataArray, a mapping, or the object itself."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import HeightmapError, InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.driven_surface import driven_surface
from joulemap.model.terrain.coordinate_systems import crs_name
from joulemap.model.terrain.decoded import SAME_LENGTH, Scaling
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.readers import ASKED_FOR, MAX_CELLS, read_sent
from joulemap.service.library.run_files import RunsLike, read_runs
from joulemap.service.questions.asking import asks
from joulemap.service.questions.reading import ReadingOptions
from joulemap.service.questions.surface import SurfaceOptions

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


GroundLike = Any
"""A heightmap, the path of its file, or a DataArray of xarray."""
RobotLike = Robot | Mapping[str, Any] | str | Path | None
"""A robot, its fields, the path of its TOML file, or None for the built-in one."""


@asks(ReadingOptions, "name", complete=False)
def read_heightmap(
    source: str | Path | bytes, *, filename: str | None = None, wanted: dict[str, Any], max_cells: int = MAX_CELLS
) -> Heightmap:
    """Read a heightmap from a file of any known format.

    The format is recognised by the content first, then by the name. Row 0 of the answer is north and unknown cells are
    NaN, whatever the file's own way.

    Parameters
    ----------
    source : str, Path or bytes
        The file, or all its bytes.
    filename : str, optional
        The name of `source` where it is bytes.
    max_cells : int, optional
        Largest number of cells.

    Returns
    -------
    Heightmap
        Heights and their place.

    Raises
    ------
    HeightmapError
        If the file cannot be read, is no heightmap, does not lie on a north-up square grid of true metres, or holds no
        known cell.
    TooLargeError
        If it declares more than `max_cells` cells; no memory is allocated for them.

    Warns
    -----
    UserWarning
        Of what was done to the heights by itself (their unit, colours), and of heights that are hardly in metres.
    """
    found = read_sent(source, filename=filename, max_cells=max_cells, alone=False, **wanted)
    for words in (*found.notes, *heightmap_warnings(found)):
        if not words.startswith(ASKED_FOR):
            warnings.warn(words, stacklevel=3)  # past what gives this function its parameters
    return found


def heightmap(
    heights: ArrayLike,
    *,
    resolution_m: float | None = None,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
    nodata: float | None = None,
) -> Heightmap:
    """Make a heightmap of an array.

    Parameters
    ----------
    heights : array_like, (rows, cols) [m]
        Row 0 is north, column 0 is west. NaN where the height is unknown. A DataArray of xarray has its coordinates `x`
        and `y` (centres of cells), in either direction, and its CRS.
    resolution_m : float, optional
        Side of a cell [m]; only a DataArray says it itself.
    west_m : float, optional
        x of the outer western edge [m].
    north_m : float, optional
        y of the outer northern edge [m]. By default the southern edge is at y = 0.
    crs : str, optional
        Coordinate system in metres, "EPSG:n" or WKT.
    nodata : float, optional
        Value that marks an unknown height, beside NaN.

    Returns
    -------
    Heightmap
        The heights as float32.

    Raises
    ------
    HeightmapError
        If the array is not two-dimensional and numeric, no height is known, a usual mark of unknown heights such as
        -9999 is not declared, or the coordinate system is unknown or not in true metres.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> jm.heightmap(np.zeros((40, 60)), resolution_m=0.5).frame.bounds
    (0.0, 0.0, 30.0, 20.0)
    """
    if hasattr(heights, "attrs") and hasattr(heights, "encoding"):
        refuse_other_units(heights)
        nodata = nodata_of(heights) if nodata is None else nodata
    if says_where(heights):
        if resolution_m is not None or west_m != 0.0 or north_m is not None:
            raise HeightmapError("a DataArray says where it lies: leave out resolution_m, west_m and north_m")
        grid = grid_of(heights)
        heights, resolution_m, west_m, north_m = grid.heights, grid.resolution_m, grid.west_m, grid.north_m
        crs = crs if crs is not None else grid.crs
    if resolution_m is None:
        raise HeightmapError("give resolution_m, the side of a cell [m]: an array does not say it")
    try:
        array = Scaling(nodata=nodata).to_metres(np.asarray(heights, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise HeightmapError(f"the heights are no array of numbers: {error}") from error
    if array.ndim != 2:
        raise HeightmapError(
            f"heights have two dimensions, rows and columns; got {array.ndim}", shape=list(array.shape)
        )
    rows, cols = array.shape
    frame = GridFrame(west_m, rows * resolution_m if north_m is None else north_m, resolution_m, rows, cols)
    named = None if crs is None else crs_name(crs, None if west_m == 0.0 and north_m is None else frame.bounds)
    return Heightmap(array, replace(frame, crs=named), source="array")


@asks(SurfaceOptions, complete=False)
def heightmap_from_runs(runs: RunsLike, *, wanted: dict[str, Any]) -> Heightmap:
    """Make a heightmap of the positions that a robot drove over, where there is no survey.

    It shows the ground as the body of the robot followed it, and only near the driven positions.

    Parameters
    ----------
    runs : Runs, str, Path or sequence of these
        Runs in one frame, with the column `z`. Make one heightmap for each run where each has a frame of its own.

    Returns
    -------
    Heightmap
        NaN far from driven positions.

    Raises
    ------
    RunsError
        If a run has no heights.
    HeightmapError
        If there are too few positions.

    Warns
    -----
    UserWarning
        If the heights of the runs differ where they meet.
    """
    found = driven_surface(read_runs(runs, crs=wanted.get("crs")).runs, **wanted)
    for warning in found.warnings:
        warnings.warn(warning, stacklevel=3)  # past what gives this function its parameters
    return found.heightmap


def ground_of(ground: GroundLike) -> Heightmap:
    """Return the heightmap that is meant."""
    if isinstance(ground, Heightmap):
        return ground
    if hasattr(ground, "coords") and hasattr(ground, "dims"):
        return heightmap(ground)
    if not isinstance(ground, str | Path):
        raise InputError(
            f"the ground is {_shown(ground)}: give a heightmap or the path of its file; "
            "joulemap.heightmap(array, resolution_m=...) makes one of an array"
        )
    return read_heightmap(ground)


def robot_of(robot: RobotLike) -> Robot:
    """Return the robot that is meant.

    `robot`: a robot, its fields, the path of its TOML file, or None for the built-in 35 kg rover.
    """
    if robot is None:
        return Robot()
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, Mapping):
        return Robot.from_mapping(robot)
    if not isinstance(robot, str | Path):
        raise InputError(f"the robot is {_shown(robot)}: give a Robot, its fields as a dict, or the path of its file")
    return Robot.from_toml(robot)


def _shown(value: object) -> str:
    return f"{type(value).__name__} {str(value)[:40]!r}"
