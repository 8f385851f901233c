"""The bounds of every number that people give: of robots, batteries, maps and questions. All of them are here.

A bound is wide enough for any ground robot or survey, and narrow enough that no formula overflows or divides by almost
nothing. The constructors of the model, the schemas of the service and the reference of robot files take them from here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Range:
    """The values that a quantity may have, both ends included.

    Attributes
    ----------
    low, high : float
        The ends, in the unit of the quantity.
    """

    low: float
    high: float

    def __contains__(self, value: Any) -> bool:
        return self.low <= value <= self.high  # false for NaN

    def __str__(self) -> str:
        return f"at least {_plain(self.low)} and at most {_plain(self.high)}"


def _plain(number: float) -> str:
    """100000 instead of 1e+05, and 1e+09 instead of ten digits."""
    return f"{number:.0f}" if 1e5 <= abs(number) < 1e7 and number == round(number) else f"{number:g}"


def short(value: object) -> str:
    """Return a value for a message, however long it is."""
    if isinstance(value, int) and abs(value) >= 10**40:  # Python refuses to write very long integers
        return "an integer of more than 40 digits"
    return str(value)[:60]


LONGEST_NAME = 200
"""Characters of a name."""

NAME_PATTERN = r"^[^\x00-\x1f\x7f-\x9f]+$"
"""A name has no control characters."""

LEAST_EFFICIENCY = 0.1
"""Of a drivetrain that drives."""

ROBOT = {
    "mass_kg": Range(0.1, 1e5),
    "width_m": Range(0.01, 10.0),
    "length_m": Range(0.01, 20.0),
    "wheel_radius_m": Range(0.001, 3.0),
    "nominal_voltage_v": Range(1.0, 2000.0),
    "speed_mps": Range(0.01, 20.0),
    "battery_wh": Range(0.01, 1e6),
    "idle_power_w": Range(0.0, 1e5),
    "max_grade_deg": Range(0.1, 60.0),
    "max_cross_slope_deg": Range(0.1, 60.0),
    "rolling_resistance": Range(0.0, 2.0),
    "drivetrain_efficiency": Range(0.0, 1.0),
    "regeneration": Range(0.0, 0.99),
    "turn_j_per_rad": Range(0.0, 1e5),
    "tracking_std_m": Range(0.0, 10.0),
    "clearance_m": Range(0.0, 10.0),
    "centre_ahead_m": Range(-10.0, 10.0),
    "min_turning_radius_m": Range(0.0, 100.0),
    "gravity_mps2": Range(0.01, 30.0),
}
"""By attribute of `Robot`, in the unit that the name ends with."""

BATTERY = {
    "capacity_wh": ROBOT["battery_wh"],
    "charge": Range(0.0, 1.0),
    "reserve": Range(0.0, 1.0),
    "health": Range(0.05, 1.0),
    "temperature_c": Range(-60.0, 80.0),
    "nominal_voltage_v": ROBOT["nominal_voltage_v"],
    "resistance_ohm": Range(0.0, 100.0),
    "cutoff_v": Range(0.0, 2000.0),
    "max_power_w": Range(0.1, 1e7),
}
"""By attribute of `Battery`."""

BATTERY_CURVES = {
    "open_circuit_v": (Range(0.0, 1.0), Range(0.1, 4000.0)),
    "capacity_curve": (Range(-60.0, 80.0), Range(0.01, 1.2)),
}
"""Of both numbers of a point, by attribute of `Battery`."""

CURVE_POINTS = 200
"""Most points of a battery's curve."""

COORDINATE_M = Range(-1e9, 1e9)
"""World coordinates [m]. Beyond these a cell's place would be lost in rounding."""

HEIGHT_M = Range(-50_000.0, 50_000.0)
"""Heights of the ground [m]. What is beyond is a no-data value or a wrong scale."""

RESOLUTION_M = Range(1e-3, 1e4)
"""Side of a cell of a heightmap [m]."""

SPACING_M = Range(0.01, 1e4)
"""Side of a cell of a cost map [m]."""

HEADING_DEG = Range(-360.0, 360.0)
"""A heading [deg, clockwise from north]."""

HEADINGS = Range(4, 360)
"""Fewest and most heading bins of a cost map."""

SCALE_M = Range(1e-9, 1e6)
"""Metres per stored unit of a heightmap's file."""

STORED = Range(-1.7976931348623157e308, 1.7976931348623157e308)
"""A stored value that means unknown: any number that a 64-bit float can be."""

TRACK_M = Range(0.01, 100.0)
"""Effective distance of the wheels of the two sides while the robot turns [m]."""

HEADING_DEG = Range(-3600.0, 3600.0)
"""A direction [deg], with whole turns added to it."""

SEARCH_S = Range(0.05, 60.0)
"""How long a planner may search [s]."""

CORRIDOR_PERCENT = Range(0.0, 1000.0)
"""How much dearer than the best the routes of a corridor may be [%]."""

NOISE_M = Range(0.0, 10.0)
"""Standard deviation of a survey's noise [m]."""
NOISE_LENGTH_M = Range(0.0, 1000.0)
"""Length over which noise is alike [m]; over more it is an offset."""

OBJECTIVES = ("mean", "quantile", "arrival")
"""What a route may be chosen by: its expected energy, a quantile of it, the probability to arrive with the reserve."""
QUANTILE = Range(0.5, 0.99)
"""A share of drives, or a probability, that may be asked for: beyond, the tails of the distribution are not known."""
MAX_CHARGES, MAX_CHARGING, MAX_STOPS, MAX_PLACES = 10, 16, 60, 200
"""Most states of charge for reach, places to charge for the point of no return, stops of a tour, and starts or goals of
a matrix, in a question."""
