"""A cost lattice for xarray: dimension names, coordinates, units and CRS after the CF conventions."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame, heading_bins
from joulemap.planner.lattice import Blocked, CostLattice

if TYPE_CHECKING:
    import xarray

GRID = ("y", "x")
BY_HEADING = (*GRID, "heading")
CRS_VARIABLE = "spatial_ref"
"""The scalar variable that carries the CRS, by the name that GDAL and rioxarray use."""

Variable = tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]
"""Dimension names, values and attributes: what xarray takes as a variable."""

DIMENSIONS: dict[str, tuple[str, ...]] = {
    "traction_per_m": BY_HEADING,
    "elevation_m": GRID,
    "gradient": (*GRID, "component"),
    "blocked": GRID,
    "std_j": BY_HEADING,
    "energy_per_m": BY_HEADING,
    "obstacles": ("square_y", "square_x"),
}

_FLAGS = {
    "flag_values": [int(reason) for reason in Blocked],
    "flag_meanings": " ".join(reason.label for reason in Blocked),
}
_ATTRIBUTES: dict[str, dict[str, Any]] = {
    "traction_per_m": {
        "units": "J m-1",
        "long_name": "energy that motion alone needs per horizontal metre",
        "comment": "on the 1 m segment centred at the cell; negative where the ground pushes the robot",
    },
    "elevation_m": {"units": "m", "long_name": "elevation of the ground at the cell centre"},
    "gradient": {
        "units": "1",
        "long_name": "slope of the square metre around the cell",
        "comment": "rise per metre of its least-squares plane",
    },
    "blocked": {"units": "1", "long_name": "why the cell may not be driven in any heading", **_FLAGS},
    "obstacles": {
        "units": "1",
        "long_name": "squares to the east that are free of obstacles, 0 on an obstacle",
        "comment": "squares of a whole number to the cell, from the north-west corner of the map",
    },
    "std_j": {"units": "J", "long_name": "standard deviation of the energy of the 1 m segment centred at the cell"},
    "energy_per_m": {
        "units": "J m-1",
        "long_name": "energy per horizontal metre",
        "comment": "of the 1 m segment centred at the cell, idle power included; NaN where that heading is blocked",
    },
}


def attributes_of(name: str, crs: str | None) -> dict[str, Any]:
    """Return the CF attributes of one of a lattice's variables.

    `name`: a name in `DIMENSIONS`; `crs`: coordinate reference system of the lattice. Result: `units`, `long_name` and
    more, all JSON-able.
    """
    return _ATTRIBUTES[name] | ({"grid_mapping": CRS_VARIABLE} if crs is not None else {})


def coordinates_of(frame: GridFrame, headings: int, *, components: bool = True) -> dict[str, Variable]:
    """Return the coordinate variables of a lattice.

    `frame`: where the cells lie; `headings`: number of heading bins K; `components`: whether to include `component`,
    the dimension of the gradient. Result: name to (dimensions, values, attributes): `y` (rows,) and `x` (cols,) [m] at
    cell centres, `heading` (K,) [degrees clockwise from north], `component` (2,), and `spatial_ref` () where the CRS is
    known.
    """
    x, y = frame.centres()
    found: dict[str, Variable] = {
        "y": (("y",), y, {"units": "m", "long_name": "northing of the cell centre", "axis": "Y"}),
        "x": (("x",), x, {"units": "m", "long_name": "easting of the cell centre", "axis": "X"}),
        "heading": (
            ("heading",),
            np.rad2deg(heading_bins(headings)),
            {"units": "degree", "long_name": "heading, clockwise from north"},
        ),
    }
    if frame.crs is not None:
        found["y"][2]["standard_name"] = "projection_y_coordinate"
        found["x"][2]["standard_name"] = "projection_x_coordinate"
        found[CRS_VARIABLE] = ((), np.array(0, dtype=np.int32), _crs_attributes(frame))
    if components:
        attributes = {"long_name": "direction of the slope", "flag_values": [0, 1], "flag_meanings": "east north"}
        found["component"] = (("component",), np.arange(2, dtype=np.uint8), attributes)
    return found


def lattice_dataset(lattice: CostLattice) -> xarray.Dataset:
    """Return a lattice as an xarray Dataset with coordinates and units.

    `lattice`: the lattice; its arrays are shared, not copied, where no value changes. Result: over `y`, `x` [m] and
    `heading` [degrees clockwise from north]: `energy_per_m` [J/m], NaN where that heading is blocked; `traction_per_m`
    [J/m]; `blocked`, a `Blocked` code by heading; `std_j` [J] where it is known; and over `y`, `x`: `elevation_m` [m].
    The attributes `robot` and `provenance` are JSON texts, so that the Dataset can be written to any format.
    """
    import xarray

    codes = lattice.blocked_by_heading()
    crs = lattice.frame.crs
    arrays: dict[str, NDArray[Any] | None] = {
        "energy_per_m": np.where(codes == Blocked.FREE, lattice.energy_per_m, np.float32(np.nan)),
        "traction_per_m": lattice.traction_per_m,
        "elevation_m": lattice.elevation_m,
        "std_j": lattice.std_j,
    }
    data: dict[str, Variable] = {
        name: (DIMENSIONS[name], values, attributes_of(name, crs))
        for name, values in arrays.items()
        if values is not None
    }
    why = {"long_name": "why the cell may not be driven in that heading"}
    data["blocked"] = (BY_HEADING, codes, attributes_of("blocked", crs) | why)
    return xarray.Dataset(
        data,
        coords=coordinates_of(lattice.frame, lattice.headings, components=False),
        attrs={
            "Conventions": "CF-1.11",
            "title": f"cost lattice of {lattice.robot.name}",
            "robot": json.dumps(lattice.robot.as_dict()),
            "provenance": json.dumps(lattice.provenance),
        },
    )


def _crs_attributes(frame: GridFrame) -> dict[str, Any]:
    """The CRS as WKT, as readers of CF want it, and where the grid lies as GDAL says it."""
    from joulemap.model.errors import HeightmapError
    from joulemap.model.terrain.crs_text import known_crs

    try:
        wkt = known_crs(frame.crs).to_wkt()
    except HeightmapError:  # a text that PROJ does not know says more than nothing
        wkt = str(frame.crs)
    step = frame.resolution_m
    return {"crs_wkt": wkt, "GeoTransform": f"{frame.west_m!r} {step!r} 0.0 {frame.north_m!r} 0.0 {-step!r}"}
