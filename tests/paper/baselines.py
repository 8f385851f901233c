"""The methods without a network: friction fitted in four ways, and a regression on shape features."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.physics import (
    eq5_traction_per_m,
    fit_rolling_resistance,
)
from joulemap.model.robot import Robot
from tests.paper.friction_map import FrictionMap
from tests.paper.measured import Measured
from tests.paper.ridge import RidgeBaseline

FloatArray = NDArray[np.float64]
Prediction = Callable[[Measured], FloatArray]
"""Energy [J] of every segment of a drive, (n,); NaN on unknown ground."""

_FAR_M = {"grass_b": 2e3, "dirt": 4e3, "elsewhere": 1e9}  # added to x: sites may share coordinates, not their ground


def global_friction(learned: Measured, robot: Robot) -> Prediction:
    """Fit equation 5 with one mu.

    Result: predicts the energy [J] of every segment of a drive, (n,); NaN on unknown ground.
    """
    here = learned.straight
    traction = (learned.segments.energy_j - robot.hotel_per_m)[here]
    mu = fit_rolling_resistance(traction, _grade(learned)[here], weight_n=robot.weight_n)
    return lambda test: robot.price_per_m(eq5_traction_per_m(robot.weight_n, mu, _grade(test)))


def friction_and_weight(learned: Measured, robot: Robot) -> Prediction:
    """Fit equation 5 with the weight too, for a robot of unknown mass or drivetrain: E = a + b tan theta.

    Result: predicts the energy [J] of every segment of a drive, (n,); NaN on unknown ground.
    """
    grade = _grade(learned)
    known = learned.straight & np.isfinite(grade)
    slope, level = np.polyfit(grade[known], learned.segments.energy_j[known], 1)
    return lambda test: np.maximum(level + slope * _grade(test), robot.hotel_per_m)


def friction_map(learned: Measured, robot: Robot) -> Prediction:
    """Fit equation 5 with a mu that depends on the place.

    Result: predicts the energy [J] of every segment of a drive, (n,); NaN on unknown ground.
    """
    s = learned.segments.take(learned.straight)
    process = FrictionMap.fit(
        s.x + _FAR_M.get(learned.site, 0.0),
        s.y,
        s.energy_j - robot.hotel_per_m,
        _grade(learned)[learned.straight],
        weight_n=robot.weight_n,
    )

    def _predict(test: Measured) -> FloatArray:
        mu = process.rolling_resistance(test.segments.x + _FAR_M.get(test.site, 0.0), test.segments.y)
        return robot.price_per_m(eq5_traction_per_m(robot.weight_n, mu, _grade(test)))

    return _predict


def shape_ridge(learned: Measured, robot: Robot) -> Prediction:
    """Fit the regression on shape features.

    Result: predicts the energy [J] of every segment of a drive, (n,); NaN on unknown ground.
    """
    s = learned.segments.take(learned.straight)
    model = RidgeBaseline.fit(learned.heightmap, robot, s.x, s.y, s.heading_rad, s.energy_j, run=s.run)
    return lambda test: model.predict_j(
        test.heightmap, robot, test.segments.x, test.segments.y, test.segments.heading_rad
    )


def local_friction(test: Measured, robot: Robot) -> FloatArray:
    """Predict each five metres with the friction of the five metres before, run by run.

    Result (n,): energy [J]; NaN in the first five metres of a run.
    """
    mu = np.full(len(test.segments), np.nan)
    grade = _grade(test)
    for run in np.unique(test.segments.run):
        mine = test.segments.run == run
        traction = test.segments.energy_j[mine] - robot.hotel_per_m
        mu[mine] = local_rolling_resistance(traction, grade[mine], weight_n=robot.weight_n)
    return robot.price_per_m(eq5_traction_per_m(robot.weight_n, mu, grade))


def local_rolling_resistance(
    traction_per_m: FloatArray, grade: FloatArray, *, weight_n: float, segments: int = 5
) -> FloatArray:
    """Fit mu for every block of segments to the block before it (section V-D, Fig. 8 right).

    Result (n,): mu; NaN in the first block.
    """
    out = np.full(traction_per_m.size, np.nan)
    for start in range(segments, out.size, segments):
        before = slice(start - segments, start)
        if (np.isfinite(traction_per_m[before]) & np.isfinite(grade[before])).any():
            mu = fit_rolling_resistance(traction_per_m[before], grade[before], weight_n=weight_n)
            out[start : start + segments] = mu
    return out


def _grade(measured: Measured) -> FloatArray:
    s = measured.segments
    return tan_grade(measured.heightmap, s.x, s.y, s.heading_rad)
