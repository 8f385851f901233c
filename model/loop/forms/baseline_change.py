"""What may have changed on the whole since the baseline runs."""

from __future__ import annotations

from dataclasses import dataclass

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
