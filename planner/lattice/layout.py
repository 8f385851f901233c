"""What lies in the folder of a cost lattice: a zarr group that xarray opens too."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, checksums
from joulemap.planner.lattice.tiles import Tiling
from joulemap.planner.lattice.xarray_dataset import CRS_VARIABLE, DIMENSIONS, attributes_of, coordinates_of

FORMAT = "joulemap.cost-lattice/1"
"""Dimension names, coordinates and units came later and are no part of it: folders without them are read as well."""
ARRAYS = ("traction_per_m", "elevation_m", "gradient", "blocked")
OPTIONAL = ("std_j",)
OBSTACLES = "obstacles"
"""The room of `Obstacles`, on squares of a whole number to the cell; without it there are none."""
CHECKED = "checksums"
"""Attribute of a lattice that has checksums: without it they are only missing in a folder of an older version."""
_COMPRESSOR = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")  # noise of the last bits does not compress: be quick


def lay_out_arrays(place: Path, tiling: Tiling, robot: Robot, *, with_std: bool, squares: int) -> None:
    """Make the group and its empty arrays. `squares`: obstacles to a cell and axis, 0 for a map without."""
    frame = tiling.frame
    group = zarr.open_group(place, mode="w")
    by_heading, side = (tiling.headings,), tiling.side
    arrays: dict[str, tuple[tuple[int, ...], str, float]] = {
        "traction_per_m": (by_heading, "float32", np.nan),
        "elevation_m": ((), "float32", np.nan),
        "gradient": ((2,), "float32", np.nan),
        "blocked": ((), "uint8", int(Blocked.UNKNOWN)),
    }
    if with_std:
        arrays["std_j"] = (by_heading, "float32", np.nan)
    for name, (more, dtype, unknown) in arrays.items():
        group.create_array(
            name,
            shape=(*frame.shape, *more),
            chunks=(*(min(side, n) for n in frame.shape), *more),
            dtype=dtype,
            fill_value=unknown,
            compressors=_COMPRESSOR,
            dimension_names=DIMENSIONS[name],
            attributes=attributes_of(name, frame.crs),
        )
    if squares:
        group.create_array(
            OBSTACLES,
            shape=tuple(squares * size for size in frame.shape),
            chunks=tuple(squares * min(side, size) for size in frame.shape),
            dtype="uint8",
            fill_value=255,
            compressors=_COMPRESSOR,
            dimension_names=DIMENSIONS[OBSTACLES],
            attributes=attributes_of(OBSTACLES, None),
        )
    for name, (dimensions, values, attributes) in coordinates_of(frame, tiling.headings).items():
        group.create_array(name, data=values, dimension_names=dimensions, attributes=attributes)
    group.attrs.update({"Conventions": "CF-1.11", **metadata(frame, robot)})
    if frame.crs is not None:
        group.attrs["coordinates"] = CRS_VARIABLE  # else xarray takes it for data


def metadata(frame: GridFrame, robot: Robot) -> dict[str, Any]:
    """Return the attributes of the group, JSON-able."""
    return {
        "format": FORMAT,
        "frame": asdict(frame),
        "robot": robot.as_dict(),
        "blocked_codes": {str(int(reason)): reason.label for reason in Blocked},
        "units": {
            "traction_per_m": "J/m",
            "std_j": "J of a 1 m segment",
            "elevation_m": "m",
            "gradient": "m/m towards east, north",
        },
    }


def is_lattice(path: Path) -> bool:
    """Whether a folder may be replaced: a lattice, or a damaged one."""
    if (path / checksums.FILE).is_file() and any((path / name).is_dir() for name in ARRAYS):
        return True
    if not (path / "zarr.json").is_file():
        return False
    try:
        node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        return str(node["attributes"]["format"]).startswith(FORMAT.split("/")[0])
    except (ValueError, KeyError, TypeError):
        return all((path / name).is_dir() for name in ARRAYS)
