"""Layers from files: rasters in their own resolution and CRS, Nav2 maps, and polygons as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
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
from joulemap.model.terrain.layers.kinds import Legend, legend_of, named_kinds, plain_name, read_legend
from joulemap.model.terrain.layers.layer import FACTOR, FREE, KINDS, OBSTACLES, ROLES, Layer, Layers
from joulemap.model.terrain.layers.nav2 import is_nav2, read_nav2
from joulemap.model.terrain.readers import MAX_CELLS, LayerFiles, recognised, source_of
from joulemap.model.terrain.target_grid import moved

_MARGIN = 2.0  # cells around the map that are read
_EDGE_POINTS = 21
_POLYGONS = (".geojson", ".json")
MOST_CORNERS = 200_000
"""Of all polygons of a request: drawing so many takes a second."""
_NAMES = ("kind", "name", "class", "surface")
"""Properties of a feature that name its kind of ground, the first that is there."""


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
        return polygon_layer(role, _document(file), ground, legend=legend, source=file.name)
    if is_nav2(file):
        if role not in (OBSTACLES, FREE):
            raise InputError(f"{file.name} is a map of Nav2, which knows obstacles: give it as obstacles or as free")
        found = read_nav2(file, ground.crs)
        if role == FREE:
            found = found._replace(values=1.0 - found.values)
        return layer_of(role, found, ground, source=file.name)
    return layer_of(role, _raster(file, ground), ground, legend=legend, source=file.name)


def read_layers(
    files: LayerFiles, ground: GridFrame, *, legend: str | Path | Mapping[str, Any] | None = None
) -> Layers:
    """Read the layers of a heightmap from files, by what they are of. `legend`: a TOML file, or its tables."""
    named = None if legend is None else legend_of(legend) if isinstance(legend, Mapping) else read_legend(legend)
    every = [
        (role, one)
        for role, some in files.items()
        for one in ([some] if isinstance(some, str | Path | bytes) else some)
    ]
    return Layers(tuple(read_layer(role, one, ground, legend=named) for role, one in every))


def layer_of(
    role: str, raster: Raster, ground: GridFrame, *, legend: Legend | None = None, source: str = "array"
) -> Layer:
    """Return the layer of numbers: NaN is unknown, and other numbers than 0 are obstacles, or free ground."""
    values, frame = _on_grid(raster, ground, source)
    if role == KINDS:
        return _of_kinds(values, frame, legend, source)
    if role in (OBSTACLES, FREE):
        occupied = np.nan_to_num(values, nan=0.0) != 0.0
        return Layer(role, source, frame, occupied if role == OBSTACLES else ~occupied)
    return Layer(role, source, frame, values.astype(np.float32))


def array_layer(role: str, values: NDArray[Any], ground: GridFrame, *, legend: Legend | None = None) -> Layer:
    """Return the layer of an array with as many cells as the heightmap."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the layer of {role} is no array of numbers: {error}") from error
    return layer_of(role, _like_the_map(numbers, ground, "the array"), ground, legend=legend)


def polygon_layer(
    role: str, document: Mapping[str, Any], ground: GridFrame, *, legend: Legend | None = None, source: str = "areas"
) -> Layer:
    """Return the layer of polygons in GeoJSON, drawn on cells as small as the heightmap's.

    Features of kinds name theirs, those of a factor or of costs have a property of that name. An obstacle is every cell
    that a polygon touches; of the others it is each whose middle lies in one.
    """
    from rasterio.features import rasterize  # loads slowly
    from rasterio.warp import transform_geom

    named = _named_crs(document, ground)
    shapes: list[tuple[Any, Any]] = []
    for geometry, properties in _features(document):
        if geometry.get("type") not in ("Polygon", "MultiPolygon"):
            raise InputError(f"{source} holds a {geometry.get('type')}: a layer is of polygons")
        if named is not None and ground.crs is not None:
            geometry = transform_geom(known_crs(named), known_crs(ground.crs), dict(geometry))
        shapes.append((geometry, _meant(role, properties, source)))
    if not shapes:
        raise InputError(f"{source} holds no polygons")
    transform = Affine(ground.resolution_m, 0.0, ground.west_m, 0.0, -ground.resolution_m, ground.north_m)
    kinds: tuple[Any, ...] = ()
    usual: float = math.nan
    if role == KINDS:
        given = () if legend is None else legend.kinds
        known = {kind.name: kind for kind in (*named_kinds(meant for _, meant in shapes).kinds, *given)}
        kinds, usual = tuple(known.values()), -1
        numbers = {name: k for k, name in enumerate(known)}
        shapes = [(geometry, numbers[meant]) for geometry, meant in shapes]
    drawn = rasterize(
        shapes, out_shape=ground.shape, transform=transform, all_touched=role == OBSTACLES, fill=usual, dtype=np.float64
    )
    if role == KINDS:
        return Layer(role, source, ground, drawn.astype(np.int16), kinds)
    if role in (OBSTACLES, FREE):
        inside = ~np.isnan(drawn)
        return Layer(role, source, ground, inside if role == OBSTACLES else ~inside)
    return Layer(role, source, ground, drawn.astype(np.float32))


def check_polygons(sent: Mapping[str, Mapping[str, Any]], ground: GridFrame, legend: Mapping[str, Any]) -> None:
    """Refuse layers of polygons that somebody sent for a heightmap, without drawing them. Raises InputError."""
    named, count, side_m = legend_of(legend) if legend else None, 0, ground.bounds[2] - ground.west_m
    whole = replace(ground, resolution_m=side_m, rows=1, cols=1)
    for role, document in sent.items():
        try:
            count += sum(1 for geometry, _ in _features(document) for _ in _corners(geometry["coordinates"]))
            if count > MOST_CORNERS:
                raise InputError(
                    f"the layers have more than {MOST_CORNERS:,} corners: simplify them", limit=MOST_CORNERS
                )
            polygon_layer(role, document, whole, legend=named, source=f"the layer of {role}")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"the layer of {role} is no GeoJSON with polygons: {error!r:.200}", role=role) from error


def _meant(role: str, properties: Mapping[str, Any], source: str) -> Any:
    if role in (OBSTACLES, FREE):
        return 1.0
    keys = _NAMES if role == KINDS else (role, "value")
    value = next((properties[key] for key in keys if properties.get(key) is not None), None)
    if value is None:
        raise InputError(
            f"a polygon of {source} does not say its {role}: give it the property {keys[0]!r}", key=keys[0]
        )
    if role == KINDS:
        return plain_name(value)
    if not math.isfinite(number := float(value)):
        raise InputError(f"a polygon of {source} has the {role} {value!r}, which is no finite number")
    if role == FACTOR and number < 0.0:
        raise InputError(f"a factor in {source} is {number:g}: below 0 driving would give energy", limit=0.0)
    return number


def _features(document: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    kind = document.get("type")
    if kind == "FeatureCollection":
        for feature in document["features"]:
            yield from _features(feature)
    elif kind == "Feature":
        yield document["geometry"], document.get("properties") or {}
    else:
        yield document, {}


def _named_crs(document: Mapping[str, Any], ground: GridFrame) -> str | None:
    """The CRS of GeoJSON: what it names, or else degrees where it looks so and the map has another (RFC 7946)."""
    named = (document.get("crs") or {}).get("properties", {}).get("name")
    if named is not None:
        return str(named)
    corners = [corner for geometry, _ in _features(document) for corner in _corners(geometry.get("coordinates", ()))]
    west, south, east, north = ground.bounds
    degrees = all(abs(x) <= 180.0 and abs(y) <= 90.0 for x, y in corners)
    inside = any(west <= x <= east and south <= y <= north for x, y in corners)
    return "EPSG:4326" if degrees and not inside and ground.crs is not None else None


def _corners(nested: Any) -> Iterator[tuple[float, float]]:
    if nested and isinstance(nested[0], int | float):
        yield float(nested[0]), float(nested[1])
    else:
        for part in nested:
            yield from _corners(part)


def read_document(path: str | Path) -> Mapping[str, Any]:
    """Return the GeoJSON of a file."""
    return _document(source_of(path, None, alone=False))


def _document(file: SourceFile) -> Mapping[str, Any]:
    try:
        with file.open() as stream:
            found = json.loads(stream.read().decode("utf-8-sig"))
        if not isinstance(found, dict) or "type" not in found:
            raise ValueError("it is no GeoJSON")
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{file.name} holds no polygons that can be read: {error}") from error
    return found


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
    raster = rasters.open_windows(file, scaling, north_up=False)
    rows, cols = raster.shape
    if raster.transform.is_identity:
        return _like_the_map(raster.read(scaling, slice(0, rows), slice(0, cols)), ground, file.name)
    row0, row1, col0, col1 = _under(ground, raster.transform, raster.own_crs, raster.shape, file.name)
    with raster.dataset() as dataset:
        values = raster.read_from(dataset, scaling, slice(row0, row1), slice(col0, col1))
    a, b, c, d, e, f = raster.transform[:6]
    corner = Affine(a, b, a * col0 + b * row0 + c, d, e, d * col0 + e * row0 + f)
    return Raster(values, corner, raster.own_crs)


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


def _of_kinds(values: NDArray[Any], frame: GridFrame, legend: Legend | None, source: str) -> Layer:
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
    return Layer(KINDS, source, frame, numbers, legend.kinds)


def areas_document(areas: Sequence[tuple[Any, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return geometries with properties as GeoJSON."""
    features = [{"type": "Feature", "geometry": shape, "properties": dict(said)} for shape, said in areas]
    return {"type": "FeatureCollection", "features": features}
