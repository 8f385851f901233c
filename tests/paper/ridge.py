"""A ridge regression on plain shape features of the ground along a segment: a baseline for the networks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.metrics import mean_relative_error
from joulemap.model.energy.shape_features import shape_features
from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

_PENALTIES = tuple(float(p) for p in 10.0 ** np.arange(-5.0, 1.01, 0.5))
_FOLDS = 5  # of a single run


@dataclass(frozen=True)
class RidgeBaseline:
    """Energy of a 1 m segment as a ridge regression on `shape_features`, their squares and products."""

    penalty: float  # Chosen by leaving out whole runs
    mean: FloatArray  # (11,): Of the features
    scale: FloatArray
    coefficients: FloatArray  # (1 + 11 + 66,): Of the constant, the features and their products [J]

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
