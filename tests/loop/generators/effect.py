"""What a hidden effect is: a force, a power, a change of the drive or the log, and which answers are right."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from joulemap.model.robot import Robot
from tests.loop.generators.config import CaseConfig
from tests.loop.generators.drive import Motion
from tests.loop.generators.robots import TrueRobot
from tests.loop.generators.site import Site

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Conditions:
    """What does not come from the motion, of one run.

    Attributes
    ----------
    temperature_degc : ndarray of float, (n,)
        Of the air.
    motor_degc : ndarray of float, (n,)
        Of the motors.
    wind_mps, wind_from_rad : float
        Of the run; from where it blows, clockwise from north.
    payload_kg : float
        Mass that is carried on top of the robot's own.
    heater : ndarray of float, (n,)
        1 while the heater is on.
    clock_s : float
        Time from the start of the first new run to the start of this one; 0 in baseline runs.
    """

    temperature_degc: FloatArray
    motor_degc: FloatArray
    wind_mps: float
    wind_from_rad: float
    payload_kg: float
    heater: FloatArray
    clock_s: float


@dataclass(frozen=True)
class Scene:
    """One run as an effect sees it.

    Attributes
    ----------
    motion : Motion
        True motion.
    robot : TrueRobot
        That drives.
    site : Site
        Where.
    conditions : Conditions
        Of the run.
    home : bool
        Whether this is the site of the baseline and new runs.
    """

    motion: Motion
    robot: TrueRobot
    site: Site
    conditions: Conditions
    home: bool


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that nobody declared. Kinds differ from this one in what they override.

    Attributes
    ----------
    size : float
        1 is the kind's usual size.
    draw : tuple of float, (4,)
        Uniform numbers from 0 to 1 by which effects of one kind differ: where, in which direction, how.
    kind : str
        Name of the kind.
    right : tuple of str
        Regular expressions: an answer is right if one is found in its name or label.
    unit : str
        Unit of the true coefficient, empty where it has none; `why_none` then says why.
    transfers : bool
        Whether it is to be expected on another site.
    between : bool
        Whether it is constant, or nearly, within a run: what it takes to find it is runs, not metres.
    either_sign : bool
        Whether the common sign of the coefficients is a convention.
    switch : bool
        Whether it depends on a column of 0 and 1, over which a curve has two coefficients.
    """

    size: float
    draw: tuple[float, float, float, float]

    kind: ClassVar[str]
    right: ClassVar[tuple[str, ...]]
    unit: ClassVar[str] = ""
    why_none: ClassVar[str] = ""
    transfers: ClassVar[bool] = True
    between: ClassVar[bool] = False
    either_sign: ClassVar[bool] = False
    switch: ClassVar[bool] = False

    def force_n(self, scene: Scene) -> FloatArray | float:
        """Force that resists the motion [N], (n,)."""
        return 0.0

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray | float:
        """Power on top of that of the motion [W], (n,), given the whole force at the ground."""
        return 0.0

    def limited_w(self, scene: Scene, power_w: FloatArray) -> FloatArray:
        """Power as the meter gives it."""
        return power_w

    def slip(self, scene: Scene) -> FloatArray | float:
        """Share of the wheels' way that is lost."""
        return 0.0

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """Settings under which the effect can be observed."""
        return config

    def coefficients(self, robot: TrueRobot) -> tuple[float, ...]:
        """True coefficients in `unit`; none where no one number says it."""
        return ()

    def stated(self, robot: TrueRobot, declared: Robot) -> tuple[float, ...]:
        """True coefficients as a model of the declared robot has them."""
        return self.coefficients(robot)

    def is_named_by(self, answer: str) -> bool:
        """Whether an answer (name and label) is a right one."""
        return any(re.search(pattern, answer.lower()) for pattern in self.right)

    def scaled(self, size: float) -> HiddenEffect:
        """The same effect in another size."""
        return replace(self, size=size)
