"""Waypoints of a mission for an autopilot, with as few corners as the energy allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.pricing.integrator import path_price, world_points
from joulemap.service.exports.positions import degrees_of
from joulemap.service.exports.simplify import corners_to_keep
from joulemap.service.exports.track import Line, Track

WAYPOINT, CHANGE_SPEED = 16, 178
"""MAV_CMD_NAV_WAYPOINT and MAV_CMD_DO_CHANGE_SPEED."""

GROUND_SPEED, UNCHANGED_THROTTLE = 1, -1
"""First and third parameter of the latter."""

TOUCHING_M = 0.01  # legs of a tour meet but for rounding


@dataclass(frozen=True)
class Mission:
    """What an autopilot is to drive.

    Attributes
    ----------
    waypoints : list of tuple of float
        Longitude, latitude [degrees], in the order of driving, the start first.
    height_m : float
        Of the start, 0 where unknown [m].
    speed_mps : float
        How fast to drive [m/s].
    energy_j : float or None
        Energy of these straight legs [J]; None where it is not known.
    """

    waypoints: list[tuple[float, float]]
    height_m: float
    speed_mps: float
    energy_j: float | None


def mission_of(track: Track) -> Mission:
    """Return the mission of the lines of a track that are driven.

    Result: its energy differs from that of the track by 1 % at most, and all its legs are on free ground.
    """
    parts: list[NDArray[np.float64]] = []
    total = 0.0
    for line in track.driven:
        corners, energy = _simplified(track, line)
        if parts and math.hypot(*(corners[0] - parts[-1][-1])[:2]) <= TOUCHING_M:
            corners = corners[1:]
        parts.append(corners)
        total += energy
    whole = Line(track.driven[0].kind, np.vstack(parts))
    height = float(whole.points[0, 2])
    return Mission(
        [(float(lon), float(lat)) for lon, lat in degrees_of(track, whole)],
        height if math.isfinite(height) else 0.0,
        track.speed_mps,
        total if math.isfinite(total) else None,
    )


def _simplified(track: Track, line: Line) -> tuple[NDArray[np.float64], float]:
    """The corners that a line needs, and the energy of its legs [J]."""
    if track.lattice is None:
        return line.points, math.nan
    points = world_points(track.lattice, line.points)
    keep = corners_to_keep(track.lattice, points)
    return line.points[keep], path_price(track.lattice, points[keep])
