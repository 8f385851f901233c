"""The ground under segments: slopes between the wheels, roughness, height and how a place lies among others."""

from __future__ import annotations

import math

import numpy as np

from joulemap.model.frames import heading_vector
from joulemap.model.robot import Robot
from joulemap.model.runs.features import LEAST_M, PLACES, FloatArray
from joulemap.model.terrain.heightmap import Heightmap

_REACH_M = 0.5  # half the side of the square metre around a segment
_ALONG = np.linspace(-2.0 * _REACH_M, 2.0 * _REACH_M, 2 * PLACES - 1)
_AROUND_M = 2.5  # radius of the surroundings of a place: several times the robot, and less than a hill
_BEARINGS = 8

_GROUND = (
    "grade",
    "grade_east",
    "grade_north",
    "cross_abs",
    "cross_sq",
    "roughness_m",
    "elevation_m",
    "position_index_m",
)


def unread_ground(n: int) -> dict[str, FloatArray]:
    """Return the features of ground that is not read. Result: as `ground_under`, all NaN."""
    return dict.fromkeys(_GROUND, np.full(n, np.nan)) | {"grades": np.full((n, PLACES), np.nan)}


def ground_under(
    heightmap: Heightmap, robot: Robot, x: FloatArray, y: FloatArray, heading_rad: FloatArray, *, moved: bool = True
) -> dict[str, FloatArray]:
    """Return slopes, roughness and height of the square metre around the middle of each segment, along its heading.

    `x`, `y` (n,): middles [m]; `heading_rad` (n,). Result (n,): by the names of `Features`; NaN where the ground is
    unknown.
    """
    dx, dy = heading_vector(heading_rad)

    def _heights_at(along: FloatArray, right: FloatArray, east: float = 0.0, north: float = 0.0) -> FloatArray:
        return heightmap.sample(
            x[:, None] - east + np.outer(dx, along) + np.outer(dy, right),
            y[:, None] - north + np.outer(dy, along) - np.outer(dx, right),
        )

    side = np.linspace(-_REACH_M, _REACH_M, PLACES)
    a, r = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    heights = _heights_at(a, r)  # (n, 25)
    plane = np.stack([np.ones_like(a), a, r], axis=1)
    coefficients = heights @ np.linalg.pinv(plane).T  # (n, 3)
    rest = heights - coefficients @ plane.T
    length, width = max(robot.length_m, LEAST_M), max(robot.width_m, LEAST_M)
    axles = np.concatenate([side - 0.5 * length, side + 0.5 * length])
    half = np.full(axles.size, 0.5 * width)
    left, right = _heights_at(axles, -half), _heights_at(axles, half)  # (n, 10): rear axle, front axle
    tilt = (left - right) / width  # > 0 down to the right
    roll = 0.5 * (tilt[:, :PLACES] + tilt[:, PLACES:])
    climb = 0.5 * (left + right)
    grade = ((climb[:, PLACES:] - climb[:, :PLACES]) / length).mean(axis=1)
    grade = np.where(np.isfinite(grade), grade, coefficients[:, 1])
    track = np.mean([_heights_at(_ALONG, np.full(_ALONG.size, w)) for w in (-0.5 * width, 0.5 * width)], axis=0)
    grades = (track[:, PLACES - 1 :] - track[:, : 1 - PLACES]) / (2.0 * _REACH_M)
    roll = np.where(np.isfinite(roll), roll, -coefficients[:, 2:])  # the wheels reach further than the square metre

    def _change(east: float, north: float) -> FloatArray:
        ends = [_heights_at(np.array([-_REACH_M, _REACH_M]), np.zeros(2), s * east, s * north) for s in (1.0, -1.0)]
        rise = [(e[:, 1] - e[:, 0]) / (2.0 * _REACH_M) for e in ends]
        return (rise[0] - rise[1]) / 2.0

    return {
        "grade": grade,
        "grades": np.where(np.isfinite(grades), grades, grade[:, None]),
        "grade_east": _change(1.0, 0.0) if moved else np.zeros(x.size),
        "grade_north": _change(0.0, 1.0) if moved else np.zeros(x.size),
        "cross_abs": np.abs(roll).mean(axis=1),
        "cross_sq": (roll**2).mean(axis=1),
        "roughness_m": np.sqrt(np.mean(rest**2, axis=1)),
        "elevation_m": coefficients[:, 0],
        "position_index_m": coefficients[:, 0] - _around(heightmap, x, y),
    }


def _around(heightmap: Heightmap, x: FloatArray, y: FloatArray) -> FloatArray:
    """(n,) mean height of the known ground on a circle of 2.5 m and on one of half its radius around each middle
    (topographic position: Weiss 2001); NaN where none is known.
    """
    dx, dy = heading_vector(np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False))
    total, count = np.zeros(x.size), np.zeros(x.size)
    for radius in (0.5 * _AROUND_M, _AROUND_M):
        heights = heightmap.sample(x[:, None] + radius * dx, y[:, None] + radius * dy)
        total += np.nansum(heights, axis=1)
        count += np.isfinite(heights).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
