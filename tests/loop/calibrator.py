"""The one module of the validation that calls the calibration: generated logs in, names and errors out, in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.loop.calibrate import Effect, calibrate
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import CARRIED, cut_segments
from joulemap.model.runs.reader import run_of
from joulemap.model.runs.segments import Segments, concatenate_segments, driven_only
from tests.loop.generators.logs import Log
from tests.loop.generators.site import CRS, Site


@dataclass(frozen=True)
class Stated:
    """A coefficient as it was reported.

    Attributes
    ----------
    value, low, high : float
        Value and its 95 % interval, in `unit`.
    unit : str
        Unit.
    """

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Answer:
    """Something that a calibration named.

    Attributes
    ----------
    name, label : str
        Its key, and what a reader sees.
    coefficients : tuple of Stated
        What it states.
    p_value : float
        As reported.
    """

    name: str
    label: str
    coefficients: tuple[Stated, ...] = ()
    p_value: float = float("nan")

    @property
    def words(self) -> str:
        """Name and label, by which it is judged."""
        return f"{self.name} | {self.label}"


class Found(Protocol):
    """The result of a calibration."""

    @property
    def answers(self) -> tuple[Answer, ...]:
        """What was named, in the order of the report."""

    @property
    def stated(self) -> float:
        """Mean relative error that the report states for runs that had no part in the fit."""

    def error_on(self, site: Site, logs: Sequence[Log], *, state: str = "after") -> float:
        """Mean relative error on other logs, of the base model ("before") or of the calibrated one ("after")."""


class Calibrator(Protocol):
    """What is tested."""

    def __call__(
        self, site: Site, robot: Robot, new: Sequence[Log], base: Sequence[Log], *, cross_validate: bool = False
    ) -> Found:
        """Calibrate `physics` with a declared robot on new runs, given baseline runs or none."""


def segments_of(logs: Sequence[Log], robot: Robot) -> Segments:
    """Segments of logs, by the same rules as files.

    Parameters
    ----------
    logs : sequence of Log
        At least one.
    robot : Robot
        As declared.

    Returns
    -------
    Segments
        Of all logs.
    """
    parts = []
    for log in logs:
        run = run_of({k: v.copy() for k, v in log.numbers.items()}, dict(log.texts), name=log.name, crs=CRS)
        parts.append(cut_segments(run, max_speed_mps=CARRIED * robot.speed_mps))
    return driven_only(concatenate_segments(parts))


@dataclass(frozen=True, eq=False)
class _Found:
    found: Any
    robot: Robot
    site: Site

    @property
    def answers(self) -> tuple[Answer, ...]:
        return tuple(answer_of(effect) for effect in self.found.effects)

    @property
    def stated(self) -> float:
        return float(self.found.errors["after"]["mean_relative"])

    def error_on(self, site: Site, logs: Sequence[Log], *, state: str = "after") -> float:
        residuals = residuals_on(PhysicsPredictor(), site.heightmap, self.robot, segments_of(logs, self.robot))[0]
        elsewhere = site is not self.site
        return float(self.found.errors_on(residuals, elsewhere=elsewhere)[state]["mean_relative"])


def joulemap(
    site: Site, robot: Robot, new: Sequence[Log], base: Sequence[Log], *, cross_validate: bool = False
) -> Found:
    """What `joulemap calibrate --model physics` finds, without its files.

    Parameters
    ----------
    site : Site
        On which the runs were driven.
    robot : Robot
        As declared.
    new, base : sequence of Log
        New runs, and baseline runs or none.
    cross_validate : bool
        Repeat the whole procedure without each run, for the error that the report states.

    Returns
    -------
    Found
        The result.
    """
    predictor = PhysicsPredictor()
    measured, electric, _ = residuals_on(predictor, site.heightmap, robot, segments_of(new, robot))
    before = residuals_on(predictor, site.heightmap, robot, segments_of(base, robot))[0] if base else None
    return _Found(calibrate(measured, electric=electric, base=before, cross_validate=cross_validate), robot, site)


def answer_of(effect: Effect) -> Answer:
    """What a calibration says of an effect."""
    term = effect.term
    stated = tuple(
        Stated(float(value), float(low), float(high), unit)
        for value, low, high, unit in zip(term.coefficients, effect.low, effect.high, term.form.units("J"), strict=True)
    )
    return Answer(term.form.name, term.form.label, stated, float(effect.p_value))
