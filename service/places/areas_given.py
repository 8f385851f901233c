"""Areas as Python users have them, as corners: polygons of shapely, tables of GeoPandas, masks of a map; GeoJSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame

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


Corners = Sequence[Any]

_INSIDE = 1e-6  # of a cell: an edge that lies on the edge of a cell would touch the next one, too


def corners_of(areas: Any, frame: GridFrame) -> list[Corners]:
    """Return the corners of each area; what is given as corners stays as it is.

    `areas`: a sequence of corners or of objects with `__geo_interface__`, one such object, or a mask (rows, cols) of
    the map that is true where no route may be.
    """
    if isinstance(areas, np.ndarray) and areas.dtype == bool:
        return _of_mask(areas, frame)
    if hasattr(areas, "__geo_interface__"):
        return list(_of_object(areas, frame))
    found: list[Corners] = []
    for area in areas:
        found += _of_object(area, frame) if hasattr(area, "__geo_interface__") else [area]
    return found


def _of_mask(mask: NDArray[np.bool_], frame: GridFrame) -> list[Corners]:
    """A rectangle for each stretch of a row, those of equal width below each other joined."""
    if mask.shape != frame.shape:
        raise InputError(
            f"the mask of `avoid` has {' x '.join(map(str, mask.shape))} cells, the cost map has "
            f"{frame.rows} x {frame.cols}",
            shape=list(mask.shape),
        )
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    open_: dict[tuple[int, int], int] = {}
    boxes: list[tuple[int, int, int, int]] = []
    for row in range(frame.rows + 1):
        now: set[tuple[int, int]] = set()
        if row < frame.rows:
            now = set(
                zip(np.flatnonzero(edges[row] > 0).tolist(), np.flatnonzero(edges[row] < 0).tolist(), strict=True)
            )
        for ended in set(open_) - now:
            boxes.append((open_.pop(ended), row, *ended))
        for begun in now - set(open_):
            open_[begun] = row
    step = frame.resolution_m

    def _box(top: int, bottom: int, left: int, right: int) -> Corners:
        west, east = frame.west_m + (left + _INSIDE) * step, frame.west_m + (right - _INSIDE) * step
        north, south = frame.north_m - (top + _INSIDE) * step, frame.north_m - (bottom - _INSIDE) * step
        return [(west, south), (east, south), (east, north), (west, north)]

    return [_box(*box) for box in boxes]


def _of_object(area: Any, frame: GridFrame) -> Iterator[Corners]:
    own = getattr(area, "crs", None)
    if own is not None and frame.crs is not None:
        area = area.to_crs(frame.crs)
    for one, _ in geometries(area.__geo_interface__):
        if one["type"] != "Polygon":
            raise InputError(
                f"`avoid` holds a {one['type']}: give polygons; `shape.buffer(metres)` makes one of a line",
                kind=one["type"],
            )
        yield from _of_rings(one["coordinates"])


def _of_rings(rings: Sequence[Any]) -> Iterator[Corners]:
    """The outer ring; one with holes is cut in two through its first hole, until no part has any."""
    if len(rings) < 2:
        yield from ([ring[:-1] for ring in rings])
        return
    from shapely.geometry import Polygon, box

    whole = Polygon(rings[0], rings[1:])
    west, south, east, north = whole.bounds
    middle = Polygon(rings[1]).centroid.x
    for half in (box(west, south, middle, north), box(middle, south, east, north)):
        part = whole.intersection(half)
        for piece in getattr(part, "geoms", [part]):
            if piece.geom_type == "Polygon" and not piece.is_empty:
                yield from _of_rings(piece.__geo_interface__["coordinates"])
