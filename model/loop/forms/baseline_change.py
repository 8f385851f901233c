"""What may have changed on the whole since the baseline runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class HotelLoad(Form):
    """Power drawn all the time, also while stationary."""

    key = "hotel_load"
    label = "idle power"
    meaning = "power drawn all the time, in addition to the declared idle power"
    unit = "{P}"
    reveals = "a minute without motion, then driving"

    def column(self, rows: Features) -> FloatArray:
        return rows.duration_s


@dataclass(frozen=True)
class RollingResistance(Form):
    """Rolling resistance in addition to that of the base model."""

    key = "rolling_resistance"
    resists = True
    label = "rolling resistance"
    meaning = "added coefficient of rolling resistance"
    unit = ""
    reveals = "a level line at two speeds, and a climb"

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.pulling


@dataclass(frozen=True)
class Mass(Form):
    """A factor on the energy of motion, as of a load that nobody logged or of another drivetrain efficiency."""

    key = "mass"
    label = "mass or drivetrain efficiency"
    meaning = "share by which the energy of motion is larger than the base model's"
    unit = ""
    reveals = "weighing the robot"

    def column(self, rows: Features) -> FloatArray:
        return rows.motion_part


@dataclass(frozen=True)
class SensorGain(Form):
    """A factor on everything that is measured."""

    key = "sensor_gain"
    label = "sensor gain"
    meaning = "share by which everything measured is larger than predicted"
    unit = ""
    reveals = "a minute without motion, then level ground and climbs"

    def column(self, rows: Features) -> FloatArray:
        return rows.hotel_and_motion


@dataclass(frozen=True)
class Acceleration(Form):
    """Mass, of the robot or of what spins in it, that is accelerated and whose energy is lost when it slows down."""

    key = "acceleration"
    label = "acceleration"
    meaning = "mass whose energy of motion is not recovered when the robot slows down"
    unit = "kg"
    reveals = "stop and go on level ground"
    low = 0.0
    planned = False

    def column(self, rows: Features) -> FloatArray:
        return rows.slowness * rows.gained_m2ps2 / rows.unit_j


@dataclass(frozen=True)
class Braking(Form):
    """Share of the energy released downhill that the battery supplies in addition, as of a motor that holds back.

    Attributes
    ----------
    from_grade : float
        Only what is steeper than this tangent is released: the rest overcomes the rolling resistance.
    """

    from_grade: float = 0.0

    key = "braking"
    label = "downhill braking"
    meaning = "share of the energy released downhill that the battery supplies on top"
    unit = ""
    reveals = "long descents at constant speed"
    covariates = ("grade",)

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.along(lambda grades: np.maximum(-grades - self.from_grade, 0.0))

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(limit) for limit in (0.0, rows.robot.rolling_resistance))


CHANGES: tuple[type[Form], ...] = (RollingResistance, HotelLoad, Mass, SensorGain, Acceleration, Braking)
"""Forms of the base model's own parameters. They are effects where baseline runs say what these were before."""
