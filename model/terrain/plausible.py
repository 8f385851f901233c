"""Whether the heights of a map can be what they are taken for: metres with decimals, on a grid of true metres."""

from __future__ import annotations

import math

import numpy as np

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.coordinate_systems import geographic, on_earth, scale_errors
from joulemap.model.terrain.crs_text import known_crs, transformer
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.windows import Ground, overview

STEEPEST = math.tan(math.radians(60.0))
"""Half of no natural ground is steeper: loose material slides at 35 degrees, and walls of rock are a small part."""

MOST_SCALE_ERROR = 0.005
"""Lengths that are wrong by more than this are said: half a per cent of the energy of a level path."""

EARTH_M = (-11_000.0, 9_000.0)
"""The Challenger Deep lies at -10,935 m, Everest at 8,849 m."""

_SMALL_M = 0.05  # 3 arc minutes are 0.05 degrees
_LEAST_CELLS = 400
_LINES = 512  # rows and columns, at least so many where there are as many, along which steps are taken for their median
_WHOLE_RANGE_M = 3.0  # flat ground may well be one whole number
_FAR_M = 10_000.0  # a local plane begins near zero, a national grid does not


def heightmap_warnings(ground: Ground) -> list[str]:
    """Return what of a map is hardly what it is taken for.

    Result: a sentence for each finding; empty where all is plausible.
    """
    sample, frame = overview(ground), ground.frame
    found = _heights(sample)
    if frame.crs is None or on_earth(frame.crs):
        found = [*_beyond_earth(sample), *found]
    else:
        found.append("the map is not of the Earth: `gravity_mps2` of the robot must be that of its body")
    if frame.crs is None:
        if max(abs(frame.west_m), abs(frame.north_m)) > _FAR_M:
            found.append(
                "the map names no coordinate reference system: logs and places in degrees cannot be used with it; give "
                "`crs`"
            )
        return found
    crs = known_crs(frame.crs)
    if not crs.is_projected:
        return found
    west, south, east, north = frame.bounds
    move = transformer(crs, geographic(crs))
    lon, lat = move.transform((west + east) / 2, (south + north) / 2)
    if math.isfinite(lon) and math.isfinite(lat):
        errors = scale_errors(frame.crs, lon, lat)
        worst = float(errors[np.argmax(np.abs(errors))])
        if abs(worst) > MOST_SCALE_ERROR:
            found.append(
                f"lengths in {frame.crs[:40]} are {abs(100 * worst):.1f} % too {'long' if worst > 0 else 'short'} "
                "here: `reproject` as auto makes them true"
            )
    return found


def _heights(sample: Heightmap) -> list[str]:
    heights = sample.heights
    known = heights[~np.isnan(heights)]
    if known.size < _LEAST_CELLS:
        return []
    lines = heights[:: max(heights.shape[0] // _LINES, 1)], heights[:, :: max(heights.shape[1] // _LINES, 1)].T
    steps = np.concatenate([np.abs(np.diff(some, axis=1)).ravel() for some in lines])
    steps = steps[~np.isnan(steps)]
    if not steps.size:
        return []
    slope = float(np.median(steps)) / sample.resolution_m
    found = _zeros(sample)
    whole = bool((known == np.round(known)).all()) and float(np.ptp(known)) >= _WHOLE_RANGE_M
    if slope > STEEPEST and _in_degrees(sample.frame):
        found.append(
            "half of the ground is nearly a wall, in cells that would be tiny: are its coordinates degrees? Then give "
            "`crs` as EPSG:4326 and `reproject` as auto"
        )
    elif slope > STEEPEST:
        unit = "centimetres: then `scale_m` is 0.01" if slope > 10 * STEEPEST or whole else "another unit than metres"
        found.append(
            f"half of the ground is steeper than {math.degrees(math.atan(slope)):.0f} degrees: are its heights in "
            f"{unit}?"
        )
    elif whole:
        found.append(
            "every height is a whole metre: steps of a metre are no ground that a robot feels, and block where it is "
            "nearly level; use a map with decimals, or a smoothed one"
        )
    return found


def _in_degrees(frame: GridFrame) -> bool:
    """Whether a map without a CRS lies where degrees would, in cells that no survey in metres has."""
    west, south, east, north = frame.bounds
    inside = west >= -180.0 and east <= 360.0 and south >= -90.0 and north <= 90.0
    return frame.crs is None and inside and frame.resolution_m < _SMALL_M


def _beyond_earth(sample: Heightmap) -> list[str]:
    known = sample.heights[~np.isnan(sample.heights)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    if EARTH_M[0] <= low and high <= EARTH_M[1]:
        return []
    return [
        f"its heights are {low:.0f} to {high:.0f} m, and the ground of the Earth lies between {EARTH_M[0]:.0f} and "
        f"{EARTH_M[1]:.0f} m: another unit (`scale_m` is 0.1 for decimetres, 0.01 for centimetres), or unknown heights "
        "(`nodata`)?"
    ]


def _zeros(sample: Heightmap) -> list[str]:
    """Blocks of exactly 0 with walls around them are unknown heights, and not a sea."""
    heights = sample.heights
    zero = heights == 0.0
    if not ((zero[:-1] & zero[1:]).any() or (zero[:, :-1] & zero[:, 1:]).any()):
        return []
    beside = [
        np.concatenate([np.abs(b[za & ~zb]), np.abs(a[zb & ~za])])
        for a, b, za, zb in (
            (heights[:-1], heights[1:], zero[:-1], zero[1:]),
            (heights[:, :-1], heights[:, 1:], zero[:, :-1], zero[:, 1:]),
        )
    ]
    steps = np.concatenate([each[~np.isnan(each)] for each in beside])
    if not steps.size or float(np.median(steps)) <= STEEPEST * sample.resolution_m:
        return []
    return [
        f"{int(zero.sum()):,} cells are exactly 0 m, and the ground beside them is {float(np.median(steps)):.4g} m "
        "away from that: are they unknown? Then give `nodata` as 0"
    ]
