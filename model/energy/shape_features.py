"""Plain features of the shape of the ground along a segment, which simple models read."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.grade import SEGMENT_M, tan_grade
from joulemap.model.frames import heading_vector
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

FEATURES = (
    "grade",
    "steepness",
    "cross_grade",
    "cross_steepness",
    "roughness",
    "track_second_difference",
    "track_roughness",
    "track_climb",
    "curvature",
    "cross_curvature",
    "twist",
)

_STEP_M = 0.1
_REACH_M = 0.7  # along the segment from its centre: wheels are before and behind the body
_TRACK_SHARE = 0.4  # of the robot's width from the centre line to the middle of a track


def shape_features(
    heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
) -> FloatArray:
    """Return plain features of the ground under 1 m segments.

    `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,). Result (n, 11): in the order of `FEATURES`; NaN
    throughout where a height is unknown.

    grade : rise over the metre, positive uphill; steepness : its size. cross_grade : of the fitted plane, positive with
    the right side higher; cross_steepness : its size. roughness : root mean square about that plane [m]. Of both wheel
    tracks: track_second_difference, root mean square of second differences [m]; track_roughness, mean deviation of a
    step from the mean step [m]; track_climb, sum of all rises [m]. curvature, cross_curvature : second-order
    coefficient along the centre line and across [1/m]. twist : standard deviation of the height of the left over the
    right track [m].
    """
    xs, ys, heading = (np.asarray(a, dtype=np.float64).ravel() for a in np.broadcast_arrays(x, y, heading_rad))
    side = _TRACK_SHARE * robot.width_m
    across = np.concatenate([offset + _STEP_M * np.arange(-1, 2) for offset in (-side, 0.0, side)])  # (9,) to the right
    steps = round(_REACH_M / _STEP_M)
    along = _STEP_M * np.arange(-steps, steps + 1)
    dx, dy = (d[:, None, None] for d in heading_vector(heading))
    ahead, right = along[None, :, None], across[None, None, :]
    z = heightmap.sample(xs[:, None, None] + ahead * dx + right * dy, ys[:, None, None] + ahead * dy - right * dx)

    inside = np.abs(along) <= 0.5 * SEGMENT_M + 1e-9
    body, body_along = z[:, inside], along[inside]
    plane = np.stack(
        [np.ones(body[0].size), np.repeat(body_along, across.size), np.tile(across, body_along.size)], axis=1
    )
    heights = body.reshape(len(body), plane.shape[0])
    coefficients = heights @ np.linalg.pinv(plane).T  # (n, 3)
    rest = heights - coefficients @ plane.T
    tracks = z[:, :, [1, 7]]  # (n, along, left and right)
    rises = np.diff(tracks, axis=1)
    grade = tan_grade(heightmap, xs, ys, heading)
    found = np.stack(
        [
            grade,
            np.abs(grade),
            coefficients[:, 2],
            np.abs(coefficients[:, 2]),
            np.sqrt(np.mean(rest**2, axis=1)),
            np.sqrt(np.mean(np.diff(rises, axis=1) ** 2, axis=1)).mean(axis=1),
            np.abs(rises - rises.mean(axis=1, keepdims=True)).mean(axis=(1, 2)),
            np.clip(rises, 0.0, None).sum(axis=1).mean(axis=1),
            body[:, :, 4] @ _second_order(body_along),
            body.mean(axis=1) @ _second_order(across),
            (tracks[:, :, 0] - tracks[:, :, 1]).std(axis=1),
        ],
        axis=1,
    )
    found[~np.isfinite(found).all(axis=1)] = np.nan
    return found


def _second_order(at: FloatArray) -> FloatArray:
    """Weights (n,) that read the coefficient of the square off values at symmetric places, blind to a straight line."""
    square = at**2 - np.mean(at**2)
    return np.asarray(square / (square @ square))
