"""What every effect consists of: the ride that it may depend on, and the quantities that it may change.

Effects are what a simulated run may contain although nobody declares it. Each is a value (`hidden_forces`,
`hidden_losses`); a run without effects is not changed at all. An effect acts where it would in nature: on the ground,
the robot, how it is driven, the forces at the wheels, the power of the drives, the power at the battery, the reading of
the current meter. Forces are those at the wheels, so that the drivetrain's losses are added, as they would be.

`amount` measures an effect in its natural unit, cumulated along the path: the energy that it takes is about a
coefficient times the amount of a segment.
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
    """A drive in progress: everything that a force or a loss may depend on."""

    drive: Drive  # The path
    motion: Motion  # What it requires of the robot
    robot: FieldRobot  # The robot as it truly is
    conditions: Conditions  # The conditions of the run
    t: FloatArray  # (n,): Time since the start, without halts [s]
    path_m: FloatArray  # (n,): Length of the path since the start [m]

    @property
    def weight_n(self) -> float:
        """True weight of the robot [N]."""
        return float(self.robot.kernel_parameters()[0])

    @property
    def clock_s(self) -> FloatArray:
        """Time since the start with all halts [s], (n,), as wind and temperature depend on it."""
        return self.t + self.conditions.halts.waited_s(self.t.size)

    @property
    def duration_s(self) -> FloatArray:
        """Duration of the step that ends at each station [s], (n,)."""
        return np.diff(self.t, prepend=self.t[0])

    @property
    def turn_rate(self) -> FloatArray:
        """Rate of turning [rad/s], (n,), > 0 to the right; smoothed over half a metre."""
        return gaussian_filter1d(self.drive.curvature, 0.25 / STEP_M, mode="nearest") * self.drive.speed_mps

    @property
    def grade_deg(self) -> FloatArray:
        """Slope along the path over about a metre [deg], (n,)."""
        return gaussian_filter1d(np.degrees(self.motion.pitch_rad), 0.4 / STEP_M, mode="nearest")

    def along_path(self, per_metre: FloatArray) -> FloatArray:
        """Integrate a quantity over the path from the start. `per_metre` is (n,). The result is (n,)."""
        return np.cumsum(per_metre * np.diff(self.path_m, prepend=self.path_m[0]))


@dataclass(frozen=True)
class Effect:
    """The contract of an effect, and no effect by itself."""

    name: ClassVar[str] = "none"  # As a calibration would call it
    unit: ClassVar[str] = ""  # Unit of the coefficient that belongs to `amount`

    def on_site(self, site: Site) -> Site:
        """Return the site as this effect changes it."""
        return site

    def on_robot(self, robot: FieldRobot, conditions: Conditions) -> FieldRobot:
        """Return the robot as this effect changes it."""
        return robot

    def on_drive(self, drive: Drive, conditions: Conditions) -> Drive:
        """Return the drive as this effect changes it."""
        return drive

    def force_n(self, ride: Ride) -> FloatArray | float:
        """Return the extra force against the motion. Result (n,): force at the wheels [N]."""
        return 0.0

    def wheels_w(self, ride: Ride, wheels_w: FloatArray) -> FloatArray:
        """Return the power of both drives as this effect changes it.

        `wheels_w` (n,): power of both drives without it [W]. Result (n,): power of both drives [W].
        """
        return wheels_w

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        """Return the power at the battery as this effect changes it.

        `power_w` (n,): power at the battery without it [W]. Result (n,): power at the battery [W].
        """
        return power_w

    def standing_w(self, power_w: float) -> float:
        """Return the power at the battery during a halt as this effect changes it. Result: power [W]."""
        return power_w

    def reading(self) -> float:
        """Return the factor on the logged current."""
        return 1.0

    def amount(self, ride: Ride) -> FloatArray | None:
        """Return what the effect is measured by, cumulated along the path.

        Result (n,): None for an effect that has no such measure.
        """
        return None

    def stated(self) -> float | None:
        """Return the coefficient where it is a parameter of the effect and needs no amount, else None."""
        return None


@dataclass(frozen=True)
class Within(Effect):
    """Another effect's forces and losses, only while a quantity lies in a range."""

    effect: Effect  # The other effect
    quantity: Literal["grade_deg", "speed_mps", "temperature_c"]  # grade_deg, speed_mps or temperature_c
    above: float = -math.inf  # Ends of the range, in the quantity's unit
    below: float = math.inf

    def __post_init__(self) -> None:
        if not self.above < self.below:
            raise InputError(f"an effect needs a range to act in, got {self.above} to {self.below}")
        for key in ("name", "unit"):
            object.__setattr__(self, key, getattr(self.effect, key))

    def acting(self, ride: Ride) -> NDArray[np.bool_]:
        """Return where the effect acts. Result (n,): True where the quantity lies in the range."""
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
