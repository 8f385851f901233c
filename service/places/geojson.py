"""What GeoJSON holds, however deep: its points, lines and polygons, one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_NONE: Mapping[str, Any] = {}
_MULTI = "Multi"


def geometries(document: Any, properties: Mapping[str, Any] = _NONE) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Yield each single geometry with the properties of its feature."""
    kind = document.get("type")
    if kind == "FeatureCollection":
        for feature in document["features"]:
            yield from geometries(feature)
    elif kind == "Feature":
        if document["geometry"] is not None:
            yield from geometries(document["geometry"], document.get("properties") or _NONE)
    elif kind == "GeometryCollection":
        for geometry in document["geometries"]:
            yield from geometries(geometry, properties)
    elif str(kind).startswith(_MULTI):
        for coordinates in document["coordinates"]:
            yield {"type": kind.removeprefix(_MULTI), "coordinates": coordinates}, properties
    else:
        yield document, properties
