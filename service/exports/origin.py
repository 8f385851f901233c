"""A local origin for ROS, parts of which keep positions as float32: at a northing of 4,000,000 m steps of 0.25 m."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from joulemap.model.errors import InputError
from joulemap.planner.lattice import CostLattice
from joulemap.service.exports.track import Line, Track

FORMATS = ("mcap", "ros-path", "nav2-map", "nav2-graph")
"""Formats that are in metres of the map, for ROS."""
START = "start"
WORDS = f"of {', '.join(FORMATS)}: the place that gets the coordinates 0,0, as x,y in metres of the map"


def check_origin(origin: str | Sequence[float] | None, format: str) -> None:
    """Refuse an origin of a format that has its own."""
    if origin is not None and format not in FORMATS:
        raise InputError(f"`origin` is for {', '.join(FORMATS)}: leave it out for {format}", format=format)


def track_from(track: Track, origin: str | Sequence[float]) -> Track:
    """Return a track whose coordinates count from an origin: x, y [m], or "start"."""
    x, y = track.driven[0].points[0, :2] if origin == START else _numbers(origin)

    def _moved(line: Line) -> Line:
        profile = line.profile and replace(line.profile, x=line.profile.x - x, y=line.profile.y - y)
        return replace(line, points=line.points - np.array([x, y, 0.0]), profile=profile)

    return replace(track, lines=tuple(map(_moved, track.lines)), crs=None, lattice=None)


def lattice_from(lattice: CostLattice, origin: str | Sequence[float]) -> CostLattice:
    """Return a lattice whose coordinates count from an origin: x, y [m]."""
    x, y = _numbers(origin)
    frame = replace(lattice.frame, west_m=lattice.frame.west_m - x, north_m=lattice.frame.north_m - y, crs=None)
    return replace(lattice, frame=frame)


def _numbers(origin: str | Sequence[float]) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in (origin.split(",") if isinstance(origin, str) else origin))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(
            f"`origin` is {origin!r}: give x,y in metres of the map, or the word {START} for the start of a route"
        )
    return x, y
