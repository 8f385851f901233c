"""Layers of polygons, as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.transform import Affine

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.formats.gdal import is_gdal_error
from joulemap.model.terrain.layers.geojson import check_reach, corners_of, corners_with_heights, named_crs, polygons_of
from joulemap.model.terrain.layers.kinds import (
    MOST_KINDS,
    MOST_LETTERS,
    MOST_VALUE,
    Legend,
    legend_of,
    named_kinds,
    plain_name,
)
from joulemap.model.terrain.layers.layer import FREE, HEIGHT, KINDS, OBSTACLES, Layer, check_numbers
from joulemap.model.terrain.readers import source_of

_UNLISTED = -2  # drawn where a polygon has a value that the legend has not
MOST_CORNERS = 200_000
"""Of all polygons of a request: drawing so many takes a second."""
_NAMES = ("kind", "name", "class", "surface", "value", "DN")
"""Properties of a feature that say its kind of ground, the first that is there; `DN` is that of gdal_polygonize."""


def polygon_layer(
    role: str, document: Mapping[str, Any], ground: GridFrame, *, legend: Legend | None = None, source: str = "areas"
) -> Layer:
    """Return the layer of polygons in GeoJSON, drawn on cells as small as the heightmap's.

    Features of kinds name theirs, those of a factor, of costs or of heights have a property of that name; heights may
    also be given at each corner, and are linear between. An obstacle is every cell that a polygon touches; of the
    others it is each whose middle lies in one.
    """
    from rasterio.features import rasterize  # loads slowly
    from rasterio.warp import transform_geom

    found = polygons_of(document, source)
    named = named_crs(document, found, ground, source)
    shapes: list[tuple[Any, Any]] = []
    for geometry, properties in found:
        if named is not None and ground.crs is not None:
            try:
                geometry = transform_geom(known_crs(named), known_crs(ground.crs), geometry)
            except Exception as error:
                if not is_gdal_error(error):
                    raise
                raise InputError(f"a polygon of {source} cannot be in {named}: {str(error)[:100]}") from error
        check_reach(geometry, ground, source)
        shapes.append((geometry, _meant(role, geometry, properties, source, legend)))
    if role == KINDS and not any(isinstance(meant, str) for _, meant in shapes):
        raise InputError(f"none of the values of {source} is in the legend: the first is {shapes[0][1]:g}")
    if not any(_meets(geometry, ground) for geometry, _ in shapes):
        raise InputError(f"no polygon of {source} lies on the heightmap: are they in its CRS, {ground.crs_in_words}?")
    transform = Affine(ground.resolution_m, 0.0, ground.west_m, 0.0, -ground.resolution_m, ground.north_m)
    kinds: tuple[Any, ...] = ()
    usual: float = math.nan
    if role == KINDS:
        given = () if legend is None else legend.kinds
        names = [meant for _, meant in shapes if isinstance(meant, str)]
        lost = {meant for _, meant in shapes if not isinstance(meant, str)}
        known = {kind.name: kind for kind in (*named_kinds(names).kinds, *given)}
        if len(known) > MOST_KINDS:
            raise InputError(f"{source} has {len(known)} kinds of ground; at most {MOST_KINDS} can be taken")
        kinds, usual = tuple(known.values()), -1
        numbers = {name: k for k, name in enumerate(known)}
        shapes = [(geometry, numbers.get(meant, _UNLISTED)) for geometry, meant in shapes]
    surfaces = [meant for _, meant in shapes]
    if role == HEIGHT:
        shapes = [(geometry, number) for number, (geometry, _) in enumerate(shapes)]
    drawn = rasterize(
        shapes, out_shape=ground.shape, transform=transform, all_touched=role == OBSTACLES, fill=usual, dtype=np.float64
    )
    if role == KINDS:
        share = float((drawn == _UNLISTED).sum()) / max(int((drawn != usual).sum()), 1)
        remark = "" if legend is None else legend.unlisted(lost, share)
        return Layer(role, source, ground, np.maximum(drawn, usual).astype(np.int16), kinds, remark=remark)
    if role in (OBSTACLES, FREE):
        inside = ~np.isnan(drawn)
        return Layer(role, source, ground, inside if role == OBSTACLES else ~inside)
    return Layer(role, source, ground, _heights(drawn, surfaces, ground) if role == HEIGHT else drawn)


def _heights(
    drawn: NDArray[np.float64], surfaces: Sequence[float | NDArray[np.float64]], ground: GridFrame
) -> NDArray[np.float64]:
    """Heights of cells by the numbers of their polygons: level, or linear between heights of corners (n, 3)."""
    from scipy.interpolate import LinearNDInterpolator  # loads slowly

    heights = np.full(drawn.shape, np.nan)
    rows, cols = np.nonzero(~np.isnan(drawn))
    numbers = drawn[rows, cols]
    for number in np.unique(numbers).astype(int):
        cells, surface = (rows[numbers == number], cols[numbers == number]), surfaces[number]
        if isinstance(surface, np.ndarray):
            middle = surface.mean(axis=0) * (1.0, 1.0, 0.0)
            x, y = ground.xy(*cells)
            linear = LinearNDInterpolator((surface - middle)[:, :2], surface[:, 2])
            heights[cells] = linear(x - middle[0], y - middle[1])
        else:
            heights[cells] = surface
    return heights


def _meets(geometry: Mapping[str, Any], ground: GridFrame) -> bool:
    corners = np.array(list(corners_of(geometry)))
    west, south, east, north = ground.bounds
    (low_x, low_y), (high_x, high_y) = corners.min(axis=0), corners.max(axis=0)
    return bool(low_x < east and high_x > west and low_y < north and high_y > south)


def check_polygons(sent: Mapping[str, Mapping[str, Any]], ground: GridFrame, legend: Mapping[str, Any]) -> None:
    """Refuse layers of polygons that somebody sent for a heightmap, without drawing them. Raises InputError."""
    named, count, side_m = legend_of(legend) if legend else None, 0, ground.bounds[2] - ground.west_m
    whole = replace(ground, resolution_m=side_m, rows=1, cols=1)
    for role, document in sent.items():
        source = f"the layer of {role}"
        count += sum(1 for geometry, _ in polygons_of(document, source) for _ in corners_of(geometry))
        if count > MOST_CORNERS:
            raise InputError(f"the layers have more than {MOST_CORNERS:,} corners: simplify them", limit=MOST_CORNERS)
        polygon_layer(role, document, whole, legend=named, source=source)


def _meant(
    role: str, geometry: Mapping[str, Any], properties: Mapping[str, Any], source: str, legend: Legend | None
) -> Any:
    if role in (OBSTACLES, FREE):
        return 1.0
    keys = _NAMES if role == KINDS else (role, "value")
    value = next((properties[key] for key in keys if properties.get(key) is not None), None)
    if value is None and role == HEIGHT and (corners := corners_with_heights(geometry)) is not None:
        check_numbers(role, corners[:, 2], source)
        return corners
    if value is None:
        or_so = ", or a height at each corner" if role == HEIGHT else ""
        raise InputError(
            f"a polygon of {source} does not say its {role}: give it the property {keys[0]!r}{or_so}", key=keys[0]
        )
    if role == KINDS:
        return _kind_meant(value, source, legend)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"a polygon of {source} has the {role} {value!r:.60}, which is no number") from error
    if math.isnan(number):
        raise InputError(f"a polygon of {source} has the {role} {number}, which is no number")
    check_numbers(role, np.array(number), source)
    return number


def _kind_meant(value: Any, source: str, legend: Legend | None) -> str | float:
    """The name of a kind of ground: as it is given, or by its value in the legend; a value that it has not."""
    if isinstance(value, str):
        if not 0 < len(name := plain_name(value)) <= MOST_LETTERS:
            raise InputError(
                f"a kind of ground in {source} has a name of {len(name)} letters: give 1 to {MOST_LETTERS}"
            )
        return name
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (is_number and abs(value) <= MOST_VALUE):
        raise InputError(f"a polygon of {source} has the kind {value!r:.60}: give a name, or a value of the legend")
    if legend is None or not legend.values:
        raise InputError(
            f"a polygon of {source} has the kind {value:g}, and no legend says which that is: give one with "
            f"value = {value:g}",
            value=str(value),
        )
    return legend.kinds[legend.values[int(value)]].name if value in legend.values else float(value)


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
