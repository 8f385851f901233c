"""Maps of Nav2's map server: a YAML file, and the picture that it names."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rasterio.transform import Affine

from joulemap.model.errors import InputError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.readers import source_of

if TYPE_CHECKING:
    from joulemap.model.terrain.layers.reading import Raster

_MOST_BYTES = 100_000
_SAVED_UNKNOWN = 205
"""What map savers write for unknown, whatever `free_thresh` they write beside it (nav2_map_server, map_io)."""


def is_nav2(file: SourceFile) -> bool:
    """Decide whether a file is the YAML of a map."""
    return file.name.lower().endswith((".yaml", ".yml"))


def read_nav2(file: SourceFile, crs: str | None) -> Raster:
    """Return the occupancy of a map: 1 where it is occupied, 0 where it is free, NaN where it is not known.

    `crs`: of the heightmap, in whose metres the map's origin is. In the modes `trinary` and `scale` a picture is as
    dark as its cells are occupied, unless `negate`; in `raw` values to 100 are the occupancy.

    Reference: nav2_map_server, map_io.
    """
    from joulemap.model.terrain.layers.reading import Raster, opened_layer

    said = _said(file)
    picture = _picture(file, str(said["image"]))
    scaling = Scaling(scale_m=1.0)
    raster = opened_layer(picture, scaling)
    rows, cols = raster.shape
    with raster.dataset() as dataset:  # as it is stored: GDAL has no place for a PGM, or a wrong one
        values = raster.read_from(dataset, scaling, slice(0, rows), slice(0, cols)).astype(np.float64)
    side, (west, south, yaw) = float(said["resolution"]), (float(v) for v in (*said["origin"], 0.0)[:3])
    if said.get("mode", "trinary") == "raw":
        share = np.where(values <= 100.0, values / 100.0, np.nan)
    else:
        share = values / 255.0 if said.get("negate") else 1.0 - values / 255.0
    occupied, free = float(said.get("occupied_thresh", 0.65)), float(said.get("free_thresh", 0.25))
    known = np.where(share > occupied, 1.0, np.where(share < free, 0.0, np.nan))
    if said.get("mode", "trinary") == "trinary":
        known[values == _SAVED_UNKNOWN] = np.nan
    east, north = side * math.cos(yaw), side * math.sin(yaw)  # by which x and y grow along a row
    place = Affine(east, north, west - north * rows, north, -east, south + east * rows)
    return Raster(known, place, crs)


def _said(file: SourceFile) -> dict[str, Any]:
    import yaml  # type: ignore[import-untyped]

    with file.open() as stream:
        text = stream.read(_MOST_BYTES)
    try:
        said = yaml.safe_load(text)
        if not isinstance(said, dict) or not {"image", "resolution", "origin"} <= set(said):
            raise ValueError("it needs image, resolution and origin")
        if not float(said["resolution"]) > 0.0 or len(said["origin"]) < 2:
            raise ValueError("its resolution or its origin is none")
    except (yaml.YAMLError, ValueError, TypeError) as error:
        raise InputError(f"{file.name} is no map of Nav2: {str(error)[:200]}") from error
    return said


def _picture(file: SourceFile, name: str) -> SourceFile:
    if isinstance(file.place, Path) and not file.alone:
        return source_of(file.place.parent / name, None, alone=False)
    content = dict(file.beside).get(Path(name).name)
    if content is None:
        raise InputError(f"{file.name} names the picture {name!r}, which did not come with it: send both in one zip")
    return SourceFile(content, name, content[:512], alone=True)
