"""What every effect is made of: the ride that it may depend on, and the points at which it may have its say.

Effects are what a simulated run may contain and nobody declares. Each is a value (`hidden_forces`, `hidden_losses`);
a run without any is exactly the run that it was. An effect acts where nature would: on the ground, the robot, how it
is driven, the forces at the wheels, the power of the drives, the power at the battery, the reading of the current
meter. Forces are those at the wheels, so that the drivetrain's losses come on top, as they would.

`amount` is what an effect is measured by in its natural unit, cumulated along the path: the energy that it takes is
about a coefficient times the amount of a segment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from joulemap.model.errors import InputError
from joulemap.model.field.conditions import Conditions
from joulemap.model.field.drives import STEP_M, Drive
from joulemap.model.field.robot_dynamics import Motion
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.sites import Site

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Ride:
    """A drive under way: all that a force or a loss may depend on. t [s], without halts, and path_m : (n,) since the
    start.
    """

    drive: Drive
    motion: Motion
    robot: FieldRobot
    conditions: Conditions
    t: FloatArray
    path_m: FloatArray

    @property
    def weight_n(self) -> float:
        return float(self.robot.kernel_parameters()[0])

    @property
    def clock_s(self) -> FloatArray:
        """Since the start with all halts (n,): what wind and temperature go by."""
        return self.t + self.conditions.halts.waited_s(self.t.size)

    @property
    def duration_s(self) -> FloatArray:
        """Of the step that ends at each station (n,)."""
        return np.diff(self.t, prepend=self.t[0])

    @property
    def turn_rate(self) -> FloatArray:
        """[rad/s], (n,), > 0 to the right; the jitter of a driven line is evened out over half a metre."""
        return gaussian_filter1d(self.drive.curvature, 0.25 / STEP_M, mode="nearest") * self.drive.speed_mps

    @property
    def grade_deg(self) -> FloatArray:
        """Climb along the way over about a metre [deg], (n,)."""
        return gaussian_filter1d(np.degrees(self.motion.pitch_rad), 0.4 / STEP_M, mode="nearest")

    def along_path(self, per_metre: FloatArray) -> FloatArray:
        """Integral of a quantity over the path from the start (n,)."""
        return np.cumsum(per_metre * np.diff(self.path_m, prepend=self.path_m[0]))


@dataclass(frozen=True)
class Effect:
    """No effect. name : as a calibration would call it. unit : of the coefficient that goes with `amount`."""

    name: ClassVar[str] = "none"
    unit: ClassVar[str] = ""

    def on_site(self, site: Site) -> Site:
        return site

    def on_robot(self, robot: FieldRobot, conditions: Conditions) -> FieldRobot:
        return robot

    def on_drive(self, drive: Drive, conditions: Conditions) -> Drive:
        return drive

    def force_n(self, ride: Ride) -> FloatArray | float:
        """Extra force against the motion [N], (n,)."""
        return 0.0

    def wheels_w(self, ride: Ride, wheels_w: FloatArray) -> FloatArray:
        """Power of both drives [W], (n,), as this effect leaves it."""
        return wheels_w

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        """Power at the battery [W], (n,), as this effect leaves it."""
        return power_w

    def standing_w(self, power_w: float) -> float:
        """Power at the battery while the robot stands [W], as this effect leaves it."""
        return power_w

    def reading(self) -> float:
        """Factor on the logged current."""
        return 1.0

    def amount(self, ride: Ride) -> FloatArray | None:
        return None

    def stated(self) -> float | None:
        """The coefficient where it needs no amount, because the effect is made of it."""
        return None


@dataclass(frozen=True)
class Within(Effect):
    """Another effect's forces and losses, only while a quantity lies in a range: it acts in part of what is driven."""

    effect: Effect
    quantity: Literal["grade_deg", "speed_mps", "temperature_c"]
    above: float = -math.inf
    below: float = math.inf

    def __post_init__(self) -> None:
        if not self.above < self.below:
            raise InputError(f"an effect needs a range to act in, got {self.above} to {self.below}")
        for key in ("name", "unit"):
            object.__setattr__(self, key, getattr(self.effect, key))

    def acting(self, ride: Ride) -> NDArray[np.bool_]:
        value = {
            "grade_deg": lambda: ride.grade_deg,
            "speed_mps": lambda: ride.drive.speed_mps,
            "temperature_c": lambda: ride.conditions.temperature_c(ride.clock_s),
        }[self.quantity]()
        return (value >= self.above) & (value <= self.below)

    def force_n(self, ride: Ride) -> FloatArray:
        return np.where(self.acting(ride), self.effect.force_n(ride), 0.0)

    def wheels_w(self, ride: Ride, wheels_w: FloatArray) -> FloatArray:
        return np.where(self.acting(ride), self.effect.wheels_w(ride, wheels_w), wheels_w)

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        return np.where(self.acting(ride), self.effect.power_w(ride, power_w), power_w)

    def amount(self, ride: Ride) -> FloatArray | None:
        whole = self.effect.amount(ride)
        return None if whole is None else np.cumsum(np.where(self.acting(ride), np.diff(whole, prepend=whole[0]), 0.0))
