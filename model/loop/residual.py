"""Residual = measured - predicted, per segment, with the scale of its noise and the runs that are held out together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from joulemap.model.errors import RunsError
from joulemap.model.loop.drive import Drive

FloatArray = NDArray[np.float64]

LEAST_SEGMENTS = 40
LEAST_FOLDS = 4

_FAR = 4.0  # times the prediction: a larger residual is a broken reading, not an effect
_STAND_NOISE = 0.4  # of the noise of a segment of the same energy: the power is even while stationary
_LEAST_STAND = 0.1  # of the usual energy of a segment: without declared idle power the prediction is nil


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured and predicted energy of segments in driving order, and of stationary intervals after them.

    Attributes
    ----------
    drive : Drive
        Features of the rows.
    measured, predicted : ndarray of float, (n,)
        Energy [J], or charge [A s]. The prediction may contain corrections in addition to `drive.predicted`.
    runs : tuple of str
        Names by number.
    charge : bool
        Whether the energy is charge, whose scale and zero are unknown.
    told : ndarray of float, (n,), optional
        Informed prediction: with the turns and payloads that the model was trained on. NaN of stationary intervals.
    """

    drive: Drive
    measured: FloatArray
    predicted: FloatArray
    runs: tuple[str, ...]
    charge: bool = False
    told: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.drive)

    @property
    def residual(self) -> FloatArray:
        """Measured minus predicted, (n,) [J, or A s]."""
        return self.measured - self.predicted

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each row is a segment and no stationary interval, (n,)."""
        return ~self.drive.standing

    @cached_property
    def scale(self) -> FloatArray:
        """Standard deviation of the noise up to one common factor, (n,), above 0.

        A constant part and a part proportional to the prediction, from the spread of the residual in ten bands of the
        prediction. It equals the energy where the noise is a share of it.
        """
        p, r, moving = self.predicted, self.residual, self.moving
        middle = max(float(np.median(p[moving])), 1e-9)
        bands = np.array_split(np.flatnonzero(moving)[np.argsort(p[moving])], 10)
        level = np.array([p[b].mean() for b in bands if b.size])
        spread = np.array([1.4826 * np.median(np.abs(r[b] - np.median(r[b]))) for b in bands if b.size])
        (constant, share), _ = nnls(np.stack([np.ones_like(level), np.maximum(level, 0.0)], axis=1), spread)
        if constant + share * middle <= 0:
            constant = 1.0
        factor = middle / (constant + share * middle)
        noise = factor * (constant + share * np.maximum(p, 0.0))
        return np.where(moving, np.maximum(noise, 0.2 * middle), _STAND_NOISE * np.maximum(p, _LEAST_STAND * middle))

    @cached_property
    def fold(self) -> NDArray[np.int64]:
        """What is held out together, (n,): the run, or blocks of a run where there are fewer than four runs."""
        runs = np.unique(self.drive.run)
        if runs.size >= LEAST_FOLDS:
            return np.searchsorted(runs, self.drive.run)
        blocks = -(-LEAST_FOLDS // runs.size)
        out = np.zeros(len(self), dtype=np.int64)
        for k, run in enumerate(runs):
            mine = np.flatnonzero(self.drive.run == run)
            out[mine] = k * blocks + np.minimum(np.arange(mine.size) * blocks // max(mine.size, 1), blocks - 1)
        return out

    @cached_property
    def block(self) -> NDArray[np.int64]:
        """Another way to hold out, (n,): the same third of every run, for effects with coefficients of each run."""
        out = np.zeros(len(self), dtype=np.int64)
        for run in np.unique(self.drive.run):
            mine = np.flatnonzero(self.drive.run == run)
            out[mine] = np.arange(mine.size) * 3 // max(mine.size, 1)
        return out

    def take(self, which: ArrayLike) -> Residuals:
        """Return some of the rows.

        Parameters
        ----------
        which : array_like
            A mask, or indices.

        Returns
        -------
        Residuals
            In the order of `which`.
        """
        index = np.asarray(which)
        return Residuals(self.drive.take(index), self.measured[index], self.predicted[index], self.runs, self.charge)

    def without_prediction(self) -> Residuals:
        """Return the residuals of a prediction of nothing, with the noise judged as before."""
        bare = Residuals(self.drive, self.measured, np.zeros(len(self)), self.runs, self.charge)
        bare.__dict__["scale"] = self.scale
        return bare

    def corrected(self, energy: FloatArray) -> Residuals:
        """Return the residuals of a corrected prediction.

        Parameters
        ----------
        energy : ndarray of float, (n,)
            To add to the prediction.

        Returns
        -------
        Residuals
            Otherwise the same.
        """
        return Residuals(self.drive, self.measured, self.predicted + energy, self.runs, self.charge)


def residuals_of(
    drive: Drive, measured: FloatArray, runs: tuple[str, ...], *, charge: bool, least: int = LEAST_SEGMENTS
) -> Residuals:
    """Return the residuals of rows whose ground is known and whose reading is not broken.

    Parameters
    ----------
    drive : Drive
        Features of the rows.
    measured : ndarray of float, (n,)
        Energy [J], or charge [A s].
    runs : tuple of str
        Names by number.
    charge : bool
        Whether it is charge.
    least : int
        Smallest number of segments.

    Returns
    -------
    Residuals
        Of the usable rows.

    Raises
    ------
    RunsError
        If fewer than `least` segments are usable.
    """
    known = drive.standing | (np.isfinite(drive.traction_per_m) & np.isfinite(drive.grade))
    predicted = drive.predicted
    if not charge:  # of a charge the scale is not known yet
        usual = np.median(predicted[known & ~drive.standing]) if (known & ~drive.standing).any() else 0.0
        known &= np.abs(measured - np.nan_to_num(predicted)) <= _FAR * np.maximum(np.nan_to_num(predicted), usual)
    kept = int((known & ~drive.standing).sum())
    if kept < least:
        driven = int((~drive.standing).sum())
        raise RunsError(
            f"only {kept} of {driven} segments of 1 m lie on ground that the heightmap knows and have a usable energy; "
            f"at least {least} are needed. Do the runs and the heightmap belong together?",
            segments=kept,
            limit=least,
        )
    return Residuals(drive.take(known), measured[known], predicted[known], runs, charge)
