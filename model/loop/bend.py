"""How far a force is felt: as far as the drives pull; where the ground pushes the robot, brakes have less to do.

Within a metre the drives' force varies with every bump. Taken as normal around its mean (spread: `spread_n`), a share
of it pushes even where the mean pulls, and what the metre costs bends smoothly from nothing (or what regeneration
returns) far downhill to the full force uphill. What another newton costs bends with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from joulemap.model.loop.drive import Drive
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_STEPS = 3
_START, _LEAST, _MOST = [1.4, 0.08, 0.05], [1.0, 0.0, 0.003], [2.0, 0.5, 0.3]  # see `spread_of`
_OUTLIER = 0.02  # of the weight
_FLAT = 1e-6  # of the spread: less force is none


def _pulled(x: FloatArray) -> FloatArray:
    """Mean of the positive part of a normal variable of mean x and deviation 1."""
    return np.asarray(x * ndtr(x) + np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi))


_MEANS = np.linspace(-2.0, 20.0, 2201)
_PULLED = _pulled(_MEANS)


@dataclass(frozen=True)
class Bend:
    """felt : coefficients of the force's columns, near to the true ones. spread_n : standard deviation of the drives'
    force within a metre [N, as the battery feels it]. share : of the force that was felt in the runs it was fitted to,
    in least squares: divided by it, a coefficient says what the force cost there on the whole.
    """

    felt: tuple[float, ...]
    spread_n: float
    share: float = 1.0

    def columns(self, drive: Drive, plain: FloatArray) -> FloatArray:
        """(n, k) the columns of a force, as far as it is felt."""
        return plain * (self.felt_share(drive, plain @ np.asarray(self.felt)) / self.share)[:, None]

    def felt_share(self, drive: Drive, energy: FloatArray) -> FloatArray:
        """(n,) share of a force's energy [J] by which the cost truly grows; all of it where the robot stands."""
        length = np.where(drive.standing, 1.0, drive.length_m)
        regained = drive.robot.regeneration
        x = _mean_force(np.nan_to_num(drive.traction_per_m) / self.spread_n, regained)
        more = energy * drive.unit_j / length / self.spread_n
        more = np.where(np.abs(more) < _FLAT, _FLAT, more)
        pulled = (_pulled(x + more) - _pulled(x)) / more
        return np.where(drive.standing, 1.0, regained + (1.0 - regained) * pulled)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Bend:
        return cls(tuple(float(v) for v in values["felt"]), float(values["spread_n"]), float(values["share"]))


def _mean_force(traction: FloatArray, regained: float) -> FloatArray:
    """Mean force of which so much is felt, both in deviations; further down than two of them as the base model goes."""
    costs = (1.0 - regained) * _PULLED + regained * _MEANS
    lowest = costs[0] / regained if costs[0] < 0.0 else costs[0]
    cost = np.where(traction < 0.0, regained * traction, traction)
    inside = np.interp(cost, costs, _MEANS)
    return np.where(traction < lowest, _MEANS[0] + traction - lowest, np.where(cost > costs[-1], cost, inside))


def spread_of(drive: Drive) -> float:
    """Spread of the drives' force within a metre [N], from how the base model's cost of motion bends with the slope.

    Least squares of k (weight) times the positive part of mu + grade + normal noise: k between 1 and 2 is what the
    drivetrain makes of a newton, mu the rolling resistance.
    """
    moving, weight, regained = ~drive.standing, drive.robot.weight_n, drive.robot.regeneration
    grade = drive.grade[moving]
    cost = drive.motion_part[moving] * drive.unit_j / drive.length_m[moving] / weight

    def away(guess: FloatArray) -> FloatArray:
        gain, rolling, spread = guess
        mean = rolling + grade
        return np.asarray(gain * ((1.0 - regained) * spread * _pulled(mean / spread) + regained * mean) - cost)

    found = least_squares(away, _START, bounds=(_LEAST, _MOST), loss="soft_l1", f_scale=_OUTLIER)
    return float(found.x[0] * found.x[2] * weight)


def bend_of(residuals: Residuals, plain: FloatArray, spread_n: float) -> Bend:
    """The bend of a force with these columns (n, k), as large as the residuals say that it is."""
    weight = (residuals.moving / residuals.scale**2)[:, None]
    bend = Bend((0.0,) * plain.shape[1], spread_n)
    for _ in range(_STEPS):
        columns = bend.columns(residuals.drive, plain)
        gram = columns.T @ (weight * columns)
        ridge = 1e-6 * max(float(np.trace(gram)), 1e-12) * np.eye(len(gram))
        felt = np.linalg.solve(gram + ridge, columns.T @ (weight[:, 0] * residuals.residual))
        bend = Bend(tuple(float(f) for f in felt), spread_n)
    force = plain @ np.asarray(bend.felt)
    whole = float(force @ force)
    share = float(force @ (force * bend.felt_share(residuals.drive, force))) / whole if whole > 0.0 else 1.0
    return Bend(tuple(round(f, 6) for f in bend.felt), round(spread_n, 3), round(max(share, 0.01), 4))
