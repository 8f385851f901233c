"""Residual = measured - predicted, per segment, with the scale of its noise and the runs that are held out whole."""

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

_FAR = 4.0  # a residual beyond so many predictions is a broken reading, not an effect
_STAND_NOISE = 0.4  # of what a moving segment of the same energy has: standing draws evenly
_LEAST_STAND = 0.1  # of the usual energy of a segment: a robot without idle power is predicted to draw nothing


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured and predicted energy of the rows of a drive (stands last, in driving order before).

    measured, predicted : (n,) [J, or A s]; predicted may hold corrections on top of `drive.predicted`. runs : names by
    number. charge : whether the energy is charge, of which neither the scale nor the zero is known. told : (n,) what
    the model says of each row with the turns and loads that it learned of, where that is another thing (NaN of stands).
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
        return self.measured - self.predicted

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        return ~self.drive.standing

    @cached_property
    def scale(self) -> FloatArray:
        """Standard deviation of the noise, up to one factor: (n,) > 0, as large as the energy itself where the noise
        is a share of it.

        A constant part and a part that goes with the prediction, from the spread of the residual in ten bands of it.
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
        """(n,) what is held out together: the run, or blocks of a run where there are fewer than four runs."""
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
        """(n,) another way to hold out: the same third of every run, for effects that each run has its own of."""
        out = np.zeros(len(self), dtype=np.int64)
        for run in np.unique(self.drive.run):
            mine = np.flatnonzero(self.drive.run == run)
            out[mine] = np.arange(mine.size) * 3 // max(mine.size, 1)
        return out

    def take(self, which: ArrayLike) -> Residuals:
        index = np.asarray(which)
        return Residuals(self.drive.take(index), self.measured[index], self.predicted[index], self.runs, self.charge)

    def without_prediction(self) -> Residuals:
        """The same with nothing predicted, noise judged as before."""
        bare = Residuals(self.drive, self.measured, np.zeros(len(self)), self.runs, self.charge)
        bare.__dict__["scale"] = self.scale
        return bare

    def corrected(self, energy: FloatArray) -> Residuals:
        """The same with `energy` added to the prediction."""
        return Residuals(self.drive, self.measured, self.predicted + energy, self.runs, self.charge)


def residuals_of(
    drive: Drive, measured: FloatArray, runs: tuple[str, ...], *, charge: bool, least: int = LEAST_SEGMENTS
) -> Residuals:
    """Residuals of the rows whose ground the heightmap knows and whose reading is not broken. Raises RunsError where
    fewer than `least` segments are left.
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
