"""Load-dependent response: a force costs energy where the drives pull, and less where the ground pushes the robot.

Within a metre the force of the drives varies with every bump. It is modelled as normal around its mean with the
standard deviation `spread_n`. A share of it pushes even where the mean pulls, so that the cost of a metre changes
smoothly from nothing (or what regeneration returns) far downhill to the full force uphill. What another newton costs
follows the same curve.
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
    """The load-dependent response of a force.

    Attributes
    ----------
    felt : tuple of float
        Coefficients of the force's columns, close to the true ones.
    spread_n : float
        Standard deviation of the drives' force within a metre [N], as the battery sees it.
    share : float
        Share of the force that cost energy in the runs of the fit, in least squares. A coefficient divided by it says
        what the force cost there in total.
    """

    felt: tuple[float, ...]
    spread_n: float
    share: float = 1.0

    def columns(self, drive: Drive, plain: FloatArray) -> FloatArray:
        """Return the columns of a force, reduced to what it costs.

        Parameters
        ----------
        drive : Drive
            Features of the segments.
        plain : ndarray of float, (n, k)
            Columns of the force.

        Returns
        -------
        ndarray of float, (n, k)
            Per unit of the coefficients.
        """
        return plain * (self.felt_share(drive, plain @ np.asarray(self.felt)) / self.share)[:, None]

    def felt_share(self, drive: Drive, energy: FloatArray) -> FloatArray:
        """Return the share of a force's energy by which the cost grows.

        Parameters
        ----------
        drive : Drive
            Features of the segments.
        energy : ndarray of float, (n,)
            Of the force over each segment [J].

        Returns
        -------
        ndarray of float, (n,)
            0..1; 1 while stationary.
        """
        length = np.where(drive.standing, 1.0, drive.length_m)
        regained = drive.robot.regeneration
        x = _mean_force(np.nan_to_num(drive.traction_per_m) / self.spread_n, regained)
        more = energy * drive.unit_j / length / self.spread_n
        more = np.where(np.abs(more) < _FLAT, _FLAT, more)
        pulled = (_pulled(x + more) - _pulled(x)) / more
        return np.where(drive.standing, 1.0, regained + (1.0 - regained) * pulled)

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-able mapping."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Bend:
        """Read what `as_dict` returned.

        Parameters
        ----------
        values : mapping
            From a file.

        Returns
        -------
        Bend
            The same.
        """
        return cls(tuple(float(v) for v in values["felt"]), float(values["spread_n"]), float(values["share"]))


def _mean_force(traction: FloatArray, regained: float) -> FloatArray:
    """Mean force that costs so much, both in standard deviations; below minus two of them as in the base model."""
    costs = (1.0 - regained) * _PULLED + regained * _MEANS
    lowest = costs[0] / regained if costs[0] < 0.0 else costs[0]
    cost = np.where(traction < 0.0, regained * traction, traction)
    inside = np.interp(cost, costs, _MEANS)
    return np.where(traction < lowest, _MEANS[0] + traction - lowest, np.where(cost > costs[-1], cost, inside))


def spread_of(drive: Drive) -> float:
    """Estimate the spread of the drives' force within a metre from how the base model's cost depends on the slope.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    float
        Standard deviation [N].

    Notes
    -----
    Least squares of k (weight) times the positive part of mu + grade + normal noise. k between 1 and 2 is what the
    drivetrain makes of a newton; mu is the rolling resistance.
    """
    moving, weight, regained = ~drive.standing, drive.robot.weight_n, drive.robot.regeneration
    grade = drive.grade[moving]
    cost = drive.motion_part[moving] * drive.unit_j / drive.length_m[moving] / weight

    def _away(guess: FloatArray) -> FloatArray:
        gain, rolling, spread = guess
        mean = rolling + grade
        return np.asarray(gain * ((1.0 - regained) * spread * _pulled(mean / spread) + regained * mean) - cost)

    found = least_squares(_away, _START, bounds=(_LEAST, _MOST), loss="soft_l1", f_scale=_OUTLIER)
    return float(found.x[0] * found.x[2] * weight)


def bend_of(residuals: Residuals, plain: FloatArray, spread_n: float) -> Bend:
    """Fit the load-dependent response of a force to residuals.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    plain : ndarray of float, (n, k)
        Columns of the force.
    spread_n : float
        See `Bend`.

    Returns
    -------
    Bend
        With the size of the force that the residuals show.
    """
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
