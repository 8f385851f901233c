"""The costs of turning, time and speeding up in measured runs: a robust, bounded regression on all metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments

FloatArray = NDArray[np.float64]

_HUBER = 3.0
"""Residuals beyond so many standard deviations count linearly (Huber 1981). A setting: 0.3 % of normal ones do."""
_PASSES = 10  # of reweighting; the coefficients no longer move in their third digit
_LEAST_SHARE = 0.2  # of the mean energy: the least that a segment's variance grows with
SHIPPED_RUN_SHARE = 0.186
"""Standard deviation of the level of a run over the rolling resistance: that of the shipped network on other sites.
Source: the runs of its training that were left out (2026-11-21)."""
_ARM_M = 2.0
"""Turning energy per radian over the weight [m], as a prior standard deviation: far more than a
friction coefficient of 1 at half the length of most robots, so that it decides only where runs hardly turn."""
_MOST_SPEED_UP = 2.0
"""Most energy of speeding up over the kinetic energy gained: half of what the motors draw is lost."""


@dataclass(frozen=True, eq=False)
class CostRows:
    """What the regression reads of n segments."""

    segments: Segments  # Measured
    robots: tuple[Robot, ...]  # That drove
    robot: NDArray[np.int64]  # (n,): Which of them drove a segment
    traction_per_m: FloatArray  # (n,): Of the network that a training starts from, or of equation 5 [J/m]
    # (n,): The part of it that the network reads from the shape of the ground, beyond rolling and climbing [J/m]
    shape_per_m: FloatArray
    tan_grade: FloatArray  # (n,): Tangent of the slope along the motion

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> CostRows:
        """Return some of the rows."""
        return CostRows(
            self.segments.take(which),
            self.robots,
            self.robot[which],
            self.traction_per_m[which],
            self.shape_per_m[which],
            self.tan_grade[which],
        )

    def of_robot(self, attribute: str) -> FloatArray:
        """Return an attribute of the robot of each row. The result is (n,)."""
        return np.array([float(getattr(robot, attribute)) for robot in self.robots])[self.robot]


@dataclass(frozen=True)
class CostFit:
    """The result of the regression."""

    costs: DriveCosts  # Of turning, time and speeding up
    # What the traction lacks on level ground, over the weight: the rolling resistance that was not declared
    level: float
    climb: float  # What it lacks over the weight and the tangent of the slope
    # What it lacks of the network's part for the shape of the ground, over that part; -1 where the part says nothing
    shape: float

    def predict_j(self, rows: CostRows) -> FloatArray:
        """Predict rows that were not fitted. Result (n,): energy [J]; NaN on unknown ground."""
        columns, names, known_j = _design(rows, self.level, self.climb, self.shape)
        mass = self.costs.mass_kg
        value = {
            "level": self.level,
            "climb": self.climb,
            "shape": self.shape,
            "turn": self.costs.turn_j_per_rad / mass,
            "slower": self.costs.driving_w or 0.0,
            "speed_up": self.costs.speed_up_kg / mass,
        }
        return known_j + columns @ np.array([value[name] for name in names])


def fit_costs(rows: CostRows) -> CostFit:
    """Fit the costs of a drive together with the level of the traction.

    Result: costs of the first robot; those of others are in proportion to their mass.

    energy = price(traction + level * weight + climb * weight * tan grade + shape * its part for the shape) * driven
    + idle * (time - driven / speed) + driving_w * slower + turn * turned + speed_up_kg * gained. Residuals have a
    variance in proportion to the energy and count by Huber's loss; `measured_runs` puts the mean right. Bounds are
    physical: no energy comes from turning or speeding up, no power below zero, no rolling resistance below zero, and
    speeding up costs at most twice the kinetic energy. Normal priors keep what the runs do not show near what is
    declared. Runs differ in level by a random effect, which predictions of other runs do not have.
    """
    known = np.isfinite(rows.traction_per_m + rows.shape_per_m + rows.tan_grade) & np.isfinite(rows.segments.energy_j)
    rows = rows.take(known)
    names, found = _coefficients(rows)
    value = dict(zip(names, found.tolist(), strict=True))
    mass = rows.robots[0].mass_kg
    costs = DriveCosts(
        turn_j_per_rad=round(mass * value["turn"], 3),
        driving_w=round(value["slower"], 3),
        speed_up_kg=round(mass * value["speed_up"], 3),
        mass_kg=mass,
    )
    return CostFit(costs, value["level"], value["climb"], value["shape"])


def _coefficients(rows: CostRows) -> tuple[list[str], FloatArray]:
    """Names and coefficients."""
    names = _design(rows)[1]
    low, high, centre, spread = _priors(rows, names)
    runs = np.unique(rows.segments.run)
    own = (rows.segments.run[:, None] == runs) if runs.size > 1 else np.zeros((len(rows.segments), 0))
    deviation = SHIPPED_RUN_SHARE * float(np.mean(rows.of_robot("rolling_resistance")))
    infinite, none = np.full(own.shape[1], np.inf), np.zeros(own.shape[1])
    low, high = np.concatenate([low, -infinite]), np.concatenate([high, infinite])
    centre, spread = np.concatenate([centre, none]), np.concatenate([spread, none + max(deviation, 1e-6)])
    found = np.clip(centre, low, high)
    energy = rows.segments.energy_j
    for _ in range(_PASSES):
        design, _, known_j = _design(rows, *found[:3])
        columns = np.concatenate([design, design[:, :1] * own], axis=1)  # each run has a level of its own
        predicted = known_j + columns @ found
        root = 1.0 / np.sqrt(_scale_j(predicted, energy))
        scaled = np.abs(energy - predicted) * root
        sigma = max(1.4826 * float(np.median(scaled)), 1e-9)
        weight = root / sigma * np.sqrt(np.minimum(1.0, _HUBER * sigma / np.maximum(scaled, 1e-12)))
        scaled_rows = np.concatenate([columns * weight[:, None] * spread, np.eye(spread.size)])
        target = np.concatenate([(energy - known_j - columns @ centre) * weight, np.zeros(spread.size)])
        tall = np.column_stack([scaled_rows, target])
        small = np.asarray(np.linalg.qr(tall, mode="r"))  # the same least squares in few rows
        bounds = (low - centre) / spread, (high - centre) / spread
        found = centre + spread * lsq_linear(small[:, :-1], small[:, -1], bounds=bounds).x
    return names, found[: len(names)]


def _design(
    rows: CostRows, level: float = 0.0, climb: float = 0.0, shape: float = 0.0
) -> tuple[FloatArray, list[str], FloatArray]:
    """Columns (n, terms), their names, and the energy that is known without them (n,).

    Where the traction with its corrections is negative, only the regenerated share of it counts.
    """
    s = rows.segments
    mass, weight = rows.of_robot("mass_kg"), rows.of_robot("weight_n")
    idle, speed = rows.of_robot("idle_power_w"), rows.of_robot("speed_mps")
    share = rows.of_robot("regeneration")
    corrected = weight * (level + climb * rows.tan_grade) + shape * rows.shape_per_m
    driving = rows.traction_per_m + corrected > 0.0
    traction = np.where(driving, rows.traction_per_m, share * rows.traction_per_m)
    counts_m = s.driven_m * np.where(driving, 1.0, share)
    known_j = idle * s.duration_s + traction * s.driven_m + rows.of_robot("turn_j_per_rad") * s.turned_abs_rad
    terms = {
        "level": weight * counts_m,
        "climb": weight * rows.tan_grade * counts_m,
        "shape": rows.shape_per_m * counts_m,
        "turn": mass * s.turned_abs_rad,
        "slower": s.duration_s - s.standing_s - s.driven_m / speed,
        "speed_up": mass * s.gained_m2ps2,
    }
    return np.stack(list(terms.values()), axis=1), list(terms), known_j


def _priors(rows: CostRows, names: list[str]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(low, high, centre, standard deviation) of every coefficient; those of turning and speeding up are per kg."""
    first = rows.robots[0]
    arm = _ARM_M * first.weight_n / first.mass_kg
    mu = float(np.mean(rows.of_robot("rolling_resistance")))
    usual_w = float(np.mean(rows.of_robot("weight_n") * rows.of_robot("speed_mps"))) * mu + first.idle_power_w
    declared = -min(robot.turn_j_per_rad / robot.mass_kg for robot in rows.robots)
    idle = -min(robot.idle_power_w for robot in rows.robots)
    table = {
        "level": (-mu, np.inf, 0.0, max(mu, 0.05)),
        "climb": (-1.0, 1.0, 0.0, 0.3),
        "shape": (-1.0, 1.0, 0.0, 0.5),
        "turn": (declared, np.inf, 0.0, arm),
        "slower": (idle, np.inf, 0.0, max(usual_w, 1.0)),
        "speed_up": (0.0, _MOST_SPEED_UP, 1.0, 1.0),
    }
    return tuple(np.array(column, dtype=np.float64) for column in zip(*(table[name] for name in names), strict=True))  # type: ignore[return-value]


def _scale_j(predicted_j: FloatArray, energy_j: FloatArray) -> FloatArray:
    """What the variance of a segment is in proportion to [J], (n,)."""
    return np.maximum(predicted_j, _LEAST_SHARE * float(np.mean(energy_j)))
