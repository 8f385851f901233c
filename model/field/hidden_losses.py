"""Hidden effects on the battery or the meter alone: loads, braking, connector, hot motors, a wrong reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from joulemap.model.field.effects import Effect, Ride
from joulemap.model.field.electrics import motor_temperature_c

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class HotelLoad(Effect):
    """A consumer that nobody declared draws power all the time."""

    extra_w: float  # Its power [W]
    name: ClassVar[str] = "hotel_load"
    unit: ClassVar[str] = "W"

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        return power_w + self.extra_w

    def standing_w(self, power_w: float) -> float:
        return power_w + self.extra_w

    def amount(self, ride: Ride) -> FloatArray:
        return ride.t


@dataclass(frozen=True)
class Braking(Effect):
    """Braking with current: downhill the controller slows the robot with power from the battery."""

    share: float  # That power over the power which the descent releases
    name: ClassVar[str] = "braking"

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        down = np.maximum(-np.sin(np.radians(ride.grade_deg)), 0.0)
        return power_w + self.share * ride.weight_n * down * ride.drive.speed_mps

    def stated(self) -> float:
        return self.share


@dataclass(frozen=True)
class SensorGain(Effect):
    """A current meter with a wrong scale."""

    gain: float  # Reading over true current
    name: ClassVar[str] = "sensor_gain"

    def reading(self) -> float:
        return self.gain

    def stated(self) -> float:
        return self.gain - 1.0


@dataclass(frozen=True)
class Connector(Effect):
    """A corroded connector behind the meter turns current into heat."""

    resistance_ohm: float  # Its resistance [ohm]
    volts: float  # Voltage that the current is computed with [V]
    name: ClassVar[str] = "battery"
    unit: ClassVar[str] = "ohm"

    def stated(self) -> float:
        return self.resistance_ohm

    def power_w(self, ride: Ride, power_w: FloatArray) -> FloatArray:
        return power_w + self.resistance_ohm * (power_w / self.volts) ** 2

    def standing_w(self, power_w: float) -> float:
        return power_w + self.resistance_ohm * (power_w / self.volts) ** 2


@dataclass(frozen=True)
class HotMotors(Effect):
    """Motors that lose efficiency when they are hot."""

    share_per_k: float  # Relative increase of the drives' power per kelvin
    from_c: float  # Temperature above which it increases [degC]
    name: ClassVar[str] = "learned:motor_temperature"

    def wheels_w(self, ride: Ride, wheels_w: FloatArray) -> FloatArray:
        air = float(ride.conditions.temperature_c(ride.clock_s).mean())
        drawn = wheels_w
        for _ in range(4):  # more power makes the motors hotter
            warmth = motor_temperature_c(drawn, ride.duration_s, air)
            drawn = wheels_w * (1.0 + self.share_per_k * np.maximum(warmth - self.from_c, 0.0))
        return drawn
