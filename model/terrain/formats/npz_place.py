"""Where the heights of a NumPy archive lie, as the arrays beside them say: edges, bounds, a transform, or centres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.terrain.decoded import SAME_LENGTH

_EDGES = {"west": "west_m west left", "south": "south_m south bottom", "east": "east_m east right"}
_EDGES |= {"north": "north_m north top"}
_ENDS = {"west": "xmin x_min minx", "south": "ymin y_min miny", "east": "xmax x_max maxx", "north": "ymax y_max maxy"}
_CORNER = {"west": "xllcorner", "south": "yllcorner"}
_BOUNDS, _TRANSFORMS = ("bounds", "bbox", "extent"), ("transform", "affine", "geotransform")
_UNCLEAR = "origin corner offset translation center centre x y x0 y0 lat lon latitude longitude easting northing pose"
_PLACES = {*_BOUNDS, *_TRANSFORMS, *_UNCLEAR.split()}
_PLACES |= {word for group in (_EDGES, _ENDS, _CORNER) for words in group.values() for word in words.split()}


@dataclass(frozen=True)
class Place:
    """Where heights lie [m]: None where the archive does not say."""

    west_m: float | None = None
    north_m: float | None = None
    resolution_m: float | None = None
    south_first: bool = False  # the first row is the southern one
    used: tuple[str, ...] = ()  # arrays


def is_of_place(name: str) -> bool:
    """Decide by its name whether an array says where the heights lie."""
    return name.lower() in _PLACES


def place_of(arrays: Mapping[str, NDArray[np.float64]], shape: tuple[int, int], side: float | None) -> Place:
    """Return the place that the first arrays tell that are clear and fit the heights.

    `arrays`: of numbers, by name; `shape`: rows and columns of the heights; `side`: of a cell [m], where it is said.
    """
    found = {name.lower(): values.ravel() for name, values in arrays.items()}
    named = {name.lower(): name for name in arrays}
    edges, ends, corner = (_single(found, group) for group in (_EDGES, _ENDS, _CORNER))
    tried: list[tuple[tuple[str, ...], Place | None]] = [
        ((key,), _of_transform(found[key], shape)) for key in _TRANSFORMS if key in found
    ]
    tried += [((key,), _of_bounds(found[key], shape, side)) for key in _BOUNDS if key in found]
    for group in (edges, ends):
        if len(group) == 4:
            four = np.array([group[key][1] for key in ("west", "south", "east", "north")])
            tried.append((tuple(name for name, _ in group.values()), _of_bounds(four, shape, side)))
    for group in (edges, corner):
        low = group.get("south", ("", None))[1]
        if "west" in group and ("north" in group or (low is not None and side is not None)):
            north = group["north"][1] if "north" in group else low + shape[0] * (side or 0.0)  # type: ignore[operator]
            used = tuple(group[key][0] for key in ("west", "north" if "north" in group else "south"))
            tried.append((used, Place(group["west"][1], north, side)))
    if "x" in found and "y" in found:
        tried.append((("x", "y"), _of_centres(found["x"], found["y"], shape)))
    for used, place in tried:
        own = place.resolution_m if place is not None else None
        if place is not None and (own is None or side is None or abs(own - side) <= SAME_LENGTH * side):
            return Place(place.west_m, place.north_m, own, place.south_first, tuple(named[name] for name in used))
    return Place()


def _single(found: Mapping[str, NDArray[np.float64]], group: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """By side of the map, the array of one number that has its name, and the number."""
    there = {side: [word for word in words.split() if word in found] for side, words in group.items()}
    return {
        k: (words[0], float(found[words[0]][0])) for k, words in there.items() if words and found[words[0]].size == 1
    }


def _of_transform(values: NDArray[np.float64], shape: tuple[int, int]) -> Place | None:
    """Of six numbers or nine, without rotation, as rasterio (a, b, c, d, e, f) or GDAL (c, a, b, f, d, e) has them."""
    if values.size not in (6, 9):
        return None
    a, b, c, d, e, f = values[:6].tolist()
    if b != 0.0 or d != 0.0:
        c, a, b, f, d, e = values[:6].tolist()
    if b != 0.0 or d != 0.0 or a <= 0.0 or abs(abs(e) - a) > SAME_LENGTH * a:
        return None
    return Place(c, f if e < 0.0 else f + shape[0] * a, a, e > 0.0)


def _of_bounds(values: NDArray[np.float64], shape: tuple[int, int], side: float | None) -> Place | None:
    """Of west, south, east and north, or west, east, south and north: of the outer edges, or of the outer centres."""
    if values.size != 4:
        return None
    for outside in (0, 1):
        for west, south, east, north in (values, values[[0, 2, 1, 3]]):
            cols, rows = shape[1] - outside, shape[0] - outside
            across, along = (east - west) / cols, (north - south) / rows
            fits = across > 0.0 and abs(across - along) <= SAME_LENGTH * across
            if fits and (side is None or abs(across - side) <= SAME_LENGTH * side):
                half = outside * across / 2
                return Place(float(west - half), float(north + half), float(across))
    return None


def _of_centres(x: NDArray[np.float64], y: NDArray[np.float64], shape: tuple[int, int]) -> Place | None:
    """Of the centres of columns and rows, at even steps."""
    if (y.size, x.size) != shape or min(shape) < 2:
        return None
    side = float(x[1] - x[0])
    steps = np.abs(np.abs(np.concatenate([np.diff(x), np.diff(y)])) - abs(side))
    if side <= 0.0 or steps.max() > SAME_LENGTH * side:
        return None
    return Place(float(x[0]) - side / 2, float(y.max()) + side / 2, side, bool(y[1] > y[0]))
