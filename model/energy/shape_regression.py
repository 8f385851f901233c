"""A ridge regression on plain shape features of the ground along a segment: a baseline for the networks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.grade import SEGMENT_M, tan_grade
from joulemap.model.energy.metrics import mean_relative_error
from joulemap.model.errors import InputError
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
_PENALTIES = tuple(float(p) for p in 10.0 ** np.arange(-5.0, 1.01, 0.5))
_FOLDS = 5  # of a single run


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


@dataclass(frozen=True)
class RidgeBaseline:
    """Energy of a 1 m segment as a ridge regression on `shape_features`, their squares and products.

    Attributes
    ----------
    penalty : float
        Chosen by leaving out whole runs.
    mean, scale : ndarray of float64, (11,)
        Of the features.
    coefficients : ndarray of float64, (1 + 11 + 66,)
        Of the constant, the features and their products [J].
    """

    penalty: float
    mean: FloatArray
    scale: FloatArray
    coefficients: FloatArray

    @classmethod
    def fit(
        cls,
        heightmap: Heightmap,
        robot: Robot,
        x: ArrayLike,
        y: ArrayLike,
        heading_rad: ArrayLike,
        energy_j: ArrayLike,
        *,
        run: ArrayLike = 0,
    ) -> RidgeBaseline:
        """Fit the regression to measured segments; those on unknown ground are left out.

        The penalty is the one with the least mean relative error when every run in turn is left out. A single run is
        divided into five parts.

        `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,); `energy_j` (n,): measured energies [J]; `run`
        (n,).
        """
        features = shape_features(heightmap, robot, x, y, heading_rad)
        energy = np.asarray(energy_j, dtype=np.float64).ravel()
        known = np.isfinite(features).all(axis=1) & np.isfinite(energy) & (energy > 0.0)
        if known.sum() < 10:
            raise InputError(
                f"{int(known.sum())} segments on known ground are too few for a regression on shape: at least 10"
            )
        features, energy = features[known], energy[known]
        fold = np.broadcast_to(np.asarray(run), known.shape)[known]
        if np.unique(fold).size < 2:
            fold = np.arange(energy.size) * _FOLDS // energy.size
        mean, scale = features.mean(axis=0), features.std(axis=0)
        scale = np.where(scale > 1e-9, scale, 1.0)
        design = _design((features - mean) / scale)
        penalty = min(_PENALTIES, key=lambda p: _left_out_error(design, energy, fold, p))
        return cls(penalty, mean, scale, _ridge(design, energy, penalty))

    def predict_j(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """Predict the energy of 1 m segments.

        `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,). Result (n,): energy [J]; NaN where the map is
        unknown.
        """
        features = shape_features(heightmap, robot, x, y, heading_rad)
        return np.asarray(_design((features - self.mean) / self.scale) @ self.coefficients)


def _design(features: FloatArray) -> FloatArray:
    """1, the features, and every product of two: (n, 1 + m + m (m + 1) / 2)."""
    i, j = np.triu_indices(features.shape[1])
    return np.concatenate([np.ones((len(features), 1)), features, features[:, i] * features[:, j]], axis=1)


def _ridge(design: FloatArray, energy: FloatArray, penalty: float) -> FloatArray:
    """Coefficients of least *relative* squares, relative to the mean of the measured energy and that of a first fit:
    relative to the measured energy alone, predictions that are too small would fit better.
    """
    weight = np.full(energy.size, 1.0 / energy.mean() ** 2)
    least = 0.2 * energy.mean()
    for _ in range(2):
        weighed = design * weight[:, None]
        normal = weighed.T @ design
        ridge = penalty * weight.sum() * np.eye(design.shape[1])
        ridge[0, 0] = 0.0
        coefficients = np.linalg.lstsq(normal + ridge, weighed.T @ energy, rcond=None)[0]
        weight = 4.0 / (np.maximum(design @ coefficients, least) + energy) ** 2
    return np.asarray(coefficients)


def _left_out_error(design: FloatArray, energy: FloatArray, fold: NDArray[np.generic], penalty: float) -> float:
    """Mean relative error on every fold, predicted from the others."""
    predicted = np.empty_like(energy)
    for one in np.unique(fold):
        out = fold == one
        predicted[out] = design[out] @ _ridge(design[~out], energy[~out], penalty)
    return mean_relative_error(predicted, energy)
