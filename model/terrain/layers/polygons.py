"""Layers of polygons, as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rasterio.transform import Affine

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.layers.kinds import Legend, legend_of, named_kinds, plain_name
from joulemap.model.terrain.layers.layer import FACTOR, FREE, KINDS, OBSTACLES, Layer
from joulemap.model.terrain.readers import source_of

MOST_CORNERS = 200_000
"""Of all polygons of a request: drawing so many takes a second."""
_NAMES = ("kind", "name", "class", "surface")
"""Properties of a feature that name its kind of ground, the first that is there."""


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
    if not any(_meets(geometry, ground) for geometry, _ in shapes):
        raise InputError(f"no polygon of {source} lies on the heightmap: are they in its CRS, {ground.crs_in_words}?")
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


def _meets(geometry: Mapping[str, Any], ground: GridFrame) -> bool:
    corners = np.array(list(_corners(geometry["coordinates"])))
    west, south, east, north = ground.bounds
    (low_x, low_y), (high_x, high_y) = corners.min(axis=0), corners.max(axis=0)
    return bool(low_x < east and high_x > west and low_y < north and high_y > south)


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
    return document_of(source_of(path, None, alone=False))


def document_of(file: SourceFile) -> Mapping[str, Any]:
    """Return the GeoJSON in a file. Raises InputError where it is none."""
    try:
        with file.open() as stream:
            found = json.loads(stream.read().decode("utf-8-sig"))
        if not isinstance(found, dict) or "type" not in found:
            raise ValueError("it is no GeoJSON")
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{file.name} holds no polygons that can be read: {error}") from error
    return found


def areas_document(areas: Sequence[tuple[Any, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return geometries with properties as GeoJSON."""
    features = [{"type": "Feature", "geometry": shape, "properties": dict(said)} for shape, said in areas]
    return {"type": "FeatureCollection", "features": features}
