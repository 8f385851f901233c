"""Layers from files: rasters in their own resolution and CRS, Nav2 maps, and polygons as GeoJSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError, InputError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.formats import raster as rasters
from joulemap.model.terrain.layers.kinds import Legend, legend_of, read_legend
from joulemap.model.terrain.layers.layer import FREE, KINDS, OBSTACLES, ROLES, Layer, check_legend
from joulemap.model.terrain.layers.nav2 import is_nav2, read_nav2
from joulemap.model.terrain.layers.polygons import document_of, polygon_layer
from joulemap.model.terrain.layers.stack import Layers
from joulemap.model.terrain.readers import MAX_CELLS, LayerFiles, recognised, source_of
from joulemap.model.terrain.target_grid import moved

_MARGIN = 2.0  # cells around the map that are read
_EDGE_POINTS = 21
_POLYGONS = (".geojson", ".json")


class Raster(NamedTuple):
    """Values of a layer where they lie: row 0 of a north-up one is north."""

    values: NDArray[Any]  # (rows, cols), NaN where unknown
    transform: Affine  # from (column, row) to x, y
    crs: str | None


def read_layer(
    role: str,
    source: str | Path | bytes,
    ground: GridFrame,
    *,
    legend: Legend | None = None,
    filename: str | None = None,
) -> Layer:
    """Read one layer for a heightmap.

    `source`: the file, or its bytes, which may then name no other file; `ground`: of the heightmap; `legend`: which
    values of a raster of kinds mean which. Result: on a grid in the CRS of the heightmap.
    """
    if role not in ROLES:
        raise InputError(f"there is no layer of {role!r}: known are {', '.join(ROLES)}", role=role)
    file = source_of(source, filename, alone=isinstance(source, bytes))
    if file.head.lstrip()[:1] == b"{" or file.name.lower().endswith(_POLYGONS):
        return polygon_layer(role, document_of(file), ground, legend=legend, source=file.name)
    if is_nav2(file):
        if role not in (OBSTACLES, FREE):
            raise InputError(f"{file.name} is a map of Nav2, which knows obstacles: give it as obstacles or as free")
        found = read_nav2(file, ground.crs)
        if role == FREE:
            found = found._replace(values=1.0 - found.values)
        return layer_of(role, found, ground, source=file.name)
    return layer_of(role, _raster(file, ground), ground, legend=legend, source=file.name)


def read_layers(
    files: LayerFiles,
    ground: GridFrame,
    *,
    legend: str | Path | Mapping[str, Any] | None = None,
    names: Mapping[str, str] = MappingProxyType({}),
) -> Layers:
    """Read the layers of a heightmap from files, by what they are of.

    `legend`: a TOML file, or its tables; `names`: what messages call the files that have other names than their own.
    """
    named = None if legend is None else legend_of(legend) if isinstance(legend, Mapping) else read_legend(legend)
    check_legend(legend, files)
    every = [
        (role, one)
        for role, some in files.items()
        for one in ([some] if isinstance(some, str | Path | bytes) else some)
    ]
    return Layers(
        tuple(
            read_layer(role, one, ground, legend=named, filename=names.get(role) or _name_of(role, one))
            for role, one in every
        )
    )


def _name_of(role: str, source: str | Path | bytes) -> str | None:
    """The name of a layer that has none of its own."""
    return f"areas of {role}" if isinstance(source, bytes) else None


def layer_of(
    role: str, raster: Raster, ground: GridFrame, *, legend: Legend | None = None, source: str = "array"
) -> Layer:
    """Return the layer of numbers: NaN is unknown, and other numbers than 0 are obstacles, or free ground."""
    values, frame = _on_grid(raster, ground, source)
    nowhere = "no coordinate reference system is known: it was taken for the map's"
    remark = nowhere if raster.crs is None and ground.crs is not None else ""
    if role == KINDS:
        return _of_kinds(values, frame, legend, source, remark)
    if role in (OBSTACLES, FREE):
        occupied = np.nan_to_num(values, nan=0.0) != 0.0
        return Layer(role, source, frame, occupied if role == OBSTACLES else ~occupied, remark=remark)
    return Layer(role, source, frame, values, remark=remark)


def array_layer(role: str, values: NDArray[Any], ground: GridFrame, *, legend: Legend | None = None) -> Layer:
    """Return the layer of an array with as many cells as the heightmap."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the layer of {role} is no array of numbers: {error}") from error
    return layer_of(role, _like_the_map(numbers, ground, "the array"), ground, legend=legend)


def _raster(file: SourceFile, ground: GridFrame) -> Raster:
    """The part of a raster that lies under the map, and where that is."""
    file, kind = recognised(file)
    scaling = Scaling(scale_m=1.0)
    if kind.code is not rasters:
        found = kind.code.decode(file, scaling, max_cells=MAX_CELLS, band=None)
        side = found.resolution_m
        if side is None or found.west_m is None or found.north_m is None:
            return _like_the_map(found.heights, ground, file.name)
        return Raster(found.heights, Affine(side, 0.0, found.west_m, 0.0, -side, found.north_m), found.crs)
    raster = opened_layer(file, scaling)
    rows, cols = raster.shape
    if raster.transform.is_identity:
        return _like_the_map(raster.read(scaling, slice(0, rows), slice(0, cols)), ground, file.name)
    row0, row1, col0, col1 = _under(ground, raster.transform, raster.own_crs, raster.shape, file.name)
    with raster.dataset() as dataset:
        values = raster.read_from(dataset, scaling, slice(row0, row1), slice(col0, col1))
    a, b, c, d, e, f = raster.transform[:6]
    corner = Affine(a, b, a * col0 + b * row0 + c, d, e, d * col0 + e * row0 + f)
    return Raster(values, corner, raster.own_crs)


def check_raster(role: str, own: GridFrame, ground: GridFrame, legend: Mapping[str, Any], *, source: str) -> None:
    """Refuse a raster that somebody sent as a layer of a heightmap, without reading it. Raises InputError.

    `own`: its grid; `ground`: that of the heightmap; `legend`: tables of the kinds of ground.
    """
    corner = Affine(own.resolution_m, 0.0, own.west_m, 0.0, -own.resolution_m, own.north_m)
    _under(ground, corner, own.crs, own.shape, source)
    if role == KINDS and not (legend and legend_of(legend).values):
        raise InputError(f"the legend gives no `value`: say which numbers of {source} are which kinds of ground")


def opened_layer(file: SourceFile, scaling: Scaling) -> Any:
    """Open the raster of a layer. Raises InputError where it has several bands: which one is meant is not known."""
    try:
        return rasters.open_windows(file, scaling, north_up=False)
    except HeightmapError as error:
        if "bands" not in error.context:
            raise
        raise InputError(
            f"the layer {file.name} has {error.context['bands']} bands, and a layer has one: write that into a file "
            "of its own (gdal_translate -b 1 does it with the first)",
            bands=error.context["bands"],
        ) from error


def _like_the_map(values: NDArray[Any], ground: GridFrame, name: str) -> Raster:
    """A layer that does not say where it lies has as many cells as the map."""
    if values.shape != ground.shape:
        raise InputError(
            f"{name} does not say where it lies, and has {' x '.join(map(str, values.shape))} cells where the "
            f"heightmap has {ground.rows} x {ground.cols}: give a GeoTIFF, or as many cells",
            shape=list(values.shape),
        )
    side = ground.resolution_m
    return Raster(values, Affine(side, 0.0, ground.west_m, 0.0, -side, ground.north_m), ground.crs)


def _under(
    ground: GridFrame, transform: Affine, crs: str | None, shape: tuple[int, int], name: str
) -> tuple[int, int, int, int]:
    """Rows and columns of a raster that lie under the map."""
    west, south, east, north = ground.bounds
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    x = west + (east - west) * np.concatenate([along, along, 0.0 * along, 0.0 * along + 1.0])
    y = south + (north - south) * np.concatenate([0.0 * along, 0.0 * along + 1.0, along, along])
    x, y = moved(ground.crs, crs, Affine.identity(), x, y)
    back = ~transform
    col, row = back.a * x + back.b * y + back.c, back.d * x + back.e * y + back.f
    row0, row1 = max(math.floor(row.min() - _MARGIN), 0), min(math.ceil(row.max() + _MARGIN), shape[0])
    col0, col1 = max(math.floor(col.min() - _MARGIN), 0), min(math.ceil(col.max() + _MARGIN), shape[1])
    if not (np.isfinite(row).all() and row0 < row1 and col0 < col1):
        raise InputError(f"the layer {name} lies outside the heightmap: do they belong together?")
    return row0, row1, col0, col1


def _on_grid(raster: Raster, ground: GridFrame, name: str) -> tuple[NDArray[Any], GridFrame]:
    """Values on a north-up grid of square cells in the CRS of the map: as they are, or each from the nearest cell."""
    values, transform, crs = raster
    rows, cols = values.shape
    same = crs is None or ground.crs is None or known_crs(crs) == known_crs(ground.crs)
    straight = transform.b == transform.d == 0.0 and transform.a > 0.0 and math.isclose(-transform.e, transform.a)
    if same and straight:
        return values, GridFrame(transform.c, transform.f, transform.a, rows, cols, ground.crs)
    x, y = moved(crs, ground.crs, transform, *np.array([[0.0, cols, 0.0, cols], [0.0, 0.0, rows, rows]]))
    if not np.isfinite(x).all():
        raise HeightmapError(f"the layer {name} cannot be reprojected to {ground.crs_in_words}")
    area = 0.5 * abs((x[3] - x[0]) * (y[2] - y[1]) - (x[2] - x[1]) * (y[3] - y[0]))  # of the quadrilateral
    west, south, east, north = ground.bounds
    west, east = max(west, x.min()), min(east, x.max())
    south, north = max(south, y.min()), min(north, y.max())
    side = min(math.sqrt(area / (rows * cols)), east - west, north - south)
    if not side > 0.0:
        raise InputError(f"the layer {name} lies outside the heightmap: do they belong together?")
    down, right = (max(math.ceil(length / side), 1) for length in (north - south, east - west))
    frame = GridFrame(west, north, side, down, right, ground.crs)
    cx, cy = frame.centres()
    gx, gy = (a.ravel() for a in np.meshgrid(cx, cy))
    sx, sy = moved(ground.crs, crs, Affine.identity(), gx, gy) if not same else (gx, gy)
    back = ~transform
    col, row = np.floor(back.a * sx + back.b * sy + back.c), np.floor(back.d * sx + back.e * sy + back.f)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    found = np.full(gx.shape, np.nan)
    found[inside] = values[row[inside].astype(int), col[inside].astype(int)]
    return found.reshape(frame.shape), frame


def _of_kinds(values: NDArray[Any], frame: GridFrame, legend: Legend | None, source: str, remark: str) -> Layer:
    stored = np.unique(values[~np.isnan(values)])
    if legend is None or not legend.values:
        some = ", ".join(f"{value:g}" for value in stored[:8])
        raise InputError(
            f"{source} has the values {some}, and nobody says which kinds of ground they are: give a legend, a TOML "
            "file with a table for each, such as [grass] with value = 1",
            values=[float(value) for value in stored[:100]],
        )
    lost = [value for value in stored.tolist() if value not in legend.values]
    if len(lost) == len(stored):
        raise InputError(f"none of the values of {source} is in the legend: the first is {lost[0]:g}" if lost else
                         f"every cell of {source} is unknown")  # fmt: skip
    numbers = np.full(values.shape, -1, dtype=np.int16)
    for value, number in legend.values.items():
        numbers[values == value] = number
    share = float(np.isin(values, lost).sum()) / max(int((~np.isnan(values)).sum()), 1)
    valued = set(legend.values.values())
    nowhere = [kind.name for number, kind in enumerate(legend.kinds) if number not in valued]
    of_none = f"no cell is of {', '.join(nowhere)}: the legend gives no value" if nowhere else ""
    remark = "; ".join(filter(None, (remark, legend.unlisted(lost, share), of_none)))
    return Layer(KINDS, source, frame, numbers, legend.kinds, remark=remark)
