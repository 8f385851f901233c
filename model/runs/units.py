"""Units of logged columns: which quantity a column is, the units it may be in, and the unit that its name says."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from joulemap.model.errors import RunsError

_FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0},
    "length": {"m": 1.0, "cm": 0.01, "mm": 1e-3, "km": 1e3, "ft": 0.3048, "in": 0.0254, "mi": 1609.344},
    "angle": {
        "deg": 1.0,
        "rad": math.degrees(1.0),
        "degE7": 1e-7,
        "semicircles": 180.0 / 2**31,
        "arcmin": 1 / 60,
        "arcmin west": -1 / 60,
    },
    "voltage": {"V": 1.0, "mV": 1e-3, "cV": 0.01, "dV": 0.1},
    "current": {"A": 1.0, "mA": 1e-3, "cA": 0.01, "dA": 0.1},
    "power": {"W": 1.0, "kW": 1e3, "mW": 1e-3, "PS": 735.49875, "hp": 745.69987},
    "energy": {"J": 1.0, "kJ": 1e3, "Wh": 3.6e3, "kWh": 3.6e6, "mWh": 3.6},
    "charge": {"As": 1.0, "Ah": 3.6e3, "mAh": 3.6},
    "share": {"%": 1.0},
    "speed": {
        "m/s": 1.0,
        "cm/s": 0.01,
        "mm/s": 1e-3,
        "km/h": 1 / 3.6,
        "mph": 0.44704,
        "in/s": 0.0254,
        "ft/s": 0.3048,
        "m/min": 1 / 60,
        "kn": 1852.0 / 3600.0,
    },
    "rotation": {"rad/s": 1.0, "rpm": math.tau / 60, "turns/s": math.tau, "deg/s": math.radians(1.0)},
    "temperature": {"degC": 1.0, "degF": 5.0 / 9.0, "K": 1.0},
    "mass": {"kg": 1.0, "g": 1e-3, "lb": 0.45359237},
}
_OFFSETS = {"degF": -160.0 / 9.0, "K": -273.15}
UNITS = {
    quantity: {unit: (factor, _OFFSETS.get(unit, 0.0)) for unit, factor in units.items()}
    for quantity, units in _FACTORS.items()
}
"""By quantity, the units it may be in, joulemap's own first: value = factor * logged + offset. SI Brochure, 9th ed.;
feet, pounds and miles are the international ones of 1959."""

_QUANTITIES = {
    target: quantity
    for quantity, targets in {
        "time": "t",
        "length": "x y z gps_error distance",
        "angle": "lat lon heading roll pitch wind_from",
        "speed": "speed speed_left speed_right wind_speed",
        "rotation": "wheel_left_rad_s wheel_right_rad_s",
        "temperature": "temperature motor_temperature",
        "mass": "payload",
        "share": "soc",
        **{same: same for same in ("voltage", "power", "energy", "charge")},
    }.items()
    for target in targets.split()
}

_SPELLINGS = {
    word: unit
    for unit, words in {
        "s": "sec secs second seconds",
        "ms": "msec millis milliseconds",
        "us": "usec µs micros",
        "ns": "nsec nsecs nanos nanosec nanoseconds",
        "d": "days",
        "m": "meter meters metres",
        "km": "kilometers",
        "ft": "feet",
        "in": "inch inches",
        "in/s": "ips",
        "mi": "miles",
        "deg": "° degrees degrees_north degrees_east",
        "rad": "radians",
        "degE7": "e7 1e7",
        "V": "volt volts",
        "A": "amp amps ampere",
        "W": "watt watts",
        "J": "joule joules",
        "%": "percent pct",
        "m/s": "ms mps m_s m/sec meters/second m.s-1",
        "km/h": "kmh kmph kph km_h km/hr",
        "mph": "mi/h miles/hour",
        "kn": "knots",
        "rad/s": "rad_s rads rad/sec radians/s",
        "rpm": "r/min rev/min 1/min u/min tr/min",
        "turns/s": "rps rev/s turn/s",
        "degC": "c °c",
        "degF": "f °f",
        "K": "k",
    }.items()
    for word in words.split()
}
_PHRASES = (
    (re.compile(r'"?\|"?([^|"]+)"?(?:\|[^|]*)*$'), r" [\1]"),  # name|unit|lowest|highest|rate
    (re.compile(r"(?i)[\W_]*(?:met(?:er|re)s?|m)_?[ ]?per_?[ ]?s(?:ec(?:ond)?)?$"), " [m/s]"),
    (re.compile(r"(?i)[\W_]*k(?:ilo)?m(?:eters?)?_?[ ]?per_?[ ]?h(?:our)?$"), " [km/h]"),
    (re.compile(r"(?i)[\W_]*mi(?:les)?_?[ ]?per_?[ ]?h(?:our)?$"), " [mph]"),
    (re.compile(r"(?i)\bkilo[ _]?watt[ _]?hours?"), "kWh"),
    (re.compile(r"(?i)(?<![a-z])watt[ _]?hours?"), "Wh"),
    (re.compile(r"(?i)(?<![a-z])amp(?:ere)?[ _]?hours?"), "Ah"),
)
"""Units that are written out, or with bars."""
PER_ROW, COUNTED = "/row", ("distance", "energy", "charge")
"""What a unit ends with where each row says what came since the row before, and the columns that may have it."""
_BRACKETED = re.compile(r"^(.*?)[\s_]*[\[(]\s*([^\])]+?)\s*[\])][\s'\"]*$")


def quantity_of(target: str) -> str | None:
    """Return the quantity of one of joulemap's columns.

    Result: a key of `UNITS`; None for a column that has no unit of its own.
    """
    if target == "current" or target.startswith("current_") or target in ("left_current", "right_current"):
        return "current"
    return _QUANTITIES.get(target)


def own_unit(target: str) -> str:
    """Return the unit in which joulemap keeps a column."""
    quantity = quantity_of(target)
    return next(iter(UNITS[quantity])) if quantity is not None else ""


def known_unit(target: str, word: str) -> str | None:
    """Return a unit by its usual name.

    Result: a key of `UNITS`, or the number; None where the quantity has no such unit.
    """
    if word.endswith(PER_ROW):
        whole = known_unit(target, word.removesuffix(PER_ROW)) if target in COUNTED else None
        return whole if whole is None else whole + PER_ROW
    quantity = quantity_of(target)
    units = UNITS.get(quantity or "", {})
    word = word.replace(" s-1", "/s").replace(" h-1", "/h")  # of the CF conventions
    for found in (word, _SPELLINGS.get(word), _SPELLINGS.get(word.lower()), word.lower()):
        if found in units:
            return found
    alike = [unit for unit in units if unit.lower() == word.lower()]  # WH, KWH; not mW for MW
    if len(alike) == 1 and word not in ("MW", "MV", "MA"):
        return alike[0]
    return word if _factor(word) is not None else None


def common_unit(words: Sequence[str]) -> tuple[str, list[float]]:
    """Return the unit of a quantity that has all of these units, and how many of it each is; none where there is none.

    `words`: such as `W` and `kW`.
    """
    for target in ("power", "current", "voltage", "energy", "charge", "speed", "x", "t"):
        units = [known_unit(target, word) for word in words]
        if all(unit is not None and _factor(unit) is None for unit in units):
            return own_unit(target), [conversion(target, str(unit))[0] for unit in units]
    return "", []


def conversion(target: str, unit: str) -> tuple[float, float]:
    """Return how values in a unit become joulemap's. Result: factor, and the offset that is added after it."""
    units = UNITS.get(quantity_of(target) or "", {})
    unit = unit.removesuffix(PER_ROW)
    if unit in units:
        return units[unit]
    factor = _factor(unit)
    if factor is None:
        known = ", ".join(units) or "none"
        raise RunsError(f"`{target}` cannot be in {unit[:40]!r}: its units are {known}, or a factor such as 0.01")
    return factor, 0.0


def unit_in_name(target: str, column: str) -> tuple[str, str | None]:
    """Return the unit that the name of a column ends with.

    `column`: such as `batt_current_mA`, `Voltage [mV]` or `speed (km/h)`. Result: the name without the unit, and the
    unit; None where the name says none.
    """
    for phrase, unit_word in _PHRASES:
        column = phrase.sub(unit_word, column)
    bracketed = _BRACKETED.match(column)
    if bracketed is not None:
        unit = known_unit(target, bracketed[2])
        if unit is not None and _factor(unit) is None:
            return bracketed[1], unit
    for size in (2, 1):  # `speed_m_s` before `speed_s`
        words = re.split(r"[_\s.]+", column)
        if len(words) > size:
            unit = known_unit(target, "_".join(words[-size:]))
            if unit is not None and _factor(unit) is None:
                return "_".join(words[:-size]), unit
    return column, None


def _factor(word: str) -> float | None:
    try:
        factor = float(word)
    except ValueError:
        return None
    return factor if math.isfinite(factor) and factor != 0 else None


def watts_of_column(column: str) -> float | None:
    """Return how many watts one unit of a logged column is, by its name.

    `column`: such as `Heating Power [kW]`, `computer_w` or `auxiliary power`. Result: None where it is not called a
    power.
    """
    name, unit = unit_in_name("power", column)
    if unit is None:
        return 1.0 if re.search(r"(?i)(^|[\W_])power([\W_]|$)", name) else None
    return UNITS["power"][unit][0]
