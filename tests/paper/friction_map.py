"""Rolling resistance as a Gaussian process over the map: a baseline that depends on the place."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError

if TYPE_CHECKING:
    from sklearn.gaussian_process import GaussianProcessRegressor

FloatArray = NDArray[np.float64]

_LEARNED = 500  # measurements from which lengths and variances are learned: the cost grows with their cube
_KEPT = 2500
_BATCH = 4096


class FrictionMap:
    """The mu of the paper's eq. 5 as a smooth function of the place. Needs scikit-learn.

    Every measured segment gives one mu = t / (m g) - tan theta. Between them a Gaussian process interpolates (squared
    exponential over the distance, plus white noise). Far from all of them it returns to their mean, which is the global
    least squares friction.

    Reference: Quann et al. 2020, "Off-road ground robot path energy cost prediction through probabilistic spatial
    mapping", Journal of Field Robotics 37(3).
    """

    def __init__(self, process: GaussianProcessRegressor, mean: float) -> None:
        self.process = process
        self.mean = mean

    @classmethod
    def fit(
        cls,
        x: ArrayLike,
        y: ArrayLike,
        traction_per_m: ArrayLike,
        tan_grade: ArrayLike,
        *,
        weight_n: float,
        seed: int = 0,
    ) -> FrictionMap:
        """Fit a map to measured segments; those with a NaN are left out.

        Lengths and variances are those of greatest likelihood on up to 500 segments; up to 2,500 are kept as data.

        `x`, `y` (n,): centres of the segments [m]; `traction_per_m` (n,): energy per horizontal metre without the hotel
        load [J/m]; `tan_grade` (n,): grades.
        """
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        columns = [np.asarray(values, dtype=np.float64).ravel() for values in (x, y, traction_per_m, tan_grade)]
        known = np.isfinite(columns).all(axis=0)
        xs, ys, traction, grade = (values[known] for values in columns)
        if xs.size < 5:
            raise InputError(f"{xs.size} segments are too few for a map of friction: at least 5")
        order = np.random.default_rng(seed).permutation(xs.size)[:_KEPT]
        places = np.stack([xs, ys], axis=1)[order]
        mu = (traction / weight_n - grade)[order]
        mean, spread = float(mu.mean()), max(float(mu.std()), 1e-6)
        kernel = ConstantKernel(0.5 * spread**2, (1e-4 * spread**2, 1e2 * spread**2)) * RBF(
            5.0, (0.5, 100.0)
        ) + WhiteKernel(0.5 * spread**2, (1e-4 * spread**2, 1e2 * spread**2))
        with warnings.catch_warnings():  # a limit that is reached is an answer: no patches, or no noise
            warnings.simplefilter("ignore", ConvergenceWarning)
            learner = GaussianProcessRegressor(kernel).fit(places[:_LEARNED], mu[:_LEARNED] - mean)
        process = GaussianProcessRegressor(learner.kernel_, optimizer=None).fit(places, mu - mean)
        return cls(process, mean)

    def rolling_resistance(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the expected mu at places. `x`, `y` (n,): places [m]. The result is (n,)."""
        places = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2).astype(np.float64)
        parts = [self.process.predict(places[k : k + _BATCH]) for k in range(0, len(places), _BATCH)]
        return self.mean + np.concatenate(parts)
