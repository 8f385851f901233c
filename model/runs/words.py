"""From the keys of quantities and counts to the words that a reader sees.

Files, reports and options keep the keys; pages, messages and the command line show the words.
"""

from __future__ import annotations

from collections.abc import Mapping

_QUANTITIES = {
    "clock": ("time since the first run began", "s"),
    "cross_slope": ("cross slope", ""),
    "driven": ("distance driven in the run", "m"),
    "elevation": ("elevation", "m"),
    "grade": ("grade", ""),
    "heading": ("heading", "rad"),
    "position_index": ("topographic position index", "m"),
    "odometer": ("distance driven since the first run", "m"),
    "roughness": ("roughness", "m"),
    "since_start": ("time since the start of the run", "s"),
    "speed": ("speed", "m/s"),
    "turn": ("heading change per segment, positive to the right", "rad"),
    "turning": ("heading change per segment", "rad"),
    "column:temperature": ("temperature", "degC"),
    "column:motor_temperature": ("motor_temperature", "degC"),
    "column:wind_speed": ("wind_speed", "m/s"),
    "column:wind_from": ("wind_from", "deg"),
    "column:roll": ("roll", "deg"),
    "column:pitch": ("pitch", "deg"),
    "column:payload": ("payload", "kg"),
}
"""Name and unit of what effects depend on. The unit of other logged columns is not known."""

_TENTHS = frozenset({"elevation"})  # may be large, and their differences small

_COUNTS = {
    "gaps": "gap{s}",
    "stops": "stop{s}",
    "remainders": "piece{s} too short for a segment",
    "fast": "where the robot was faster than it can drive",
    "undriven": "in runs in which the robot was carried",
    "truncated_rows": "incomplete last row{s}",
    "rows_without_time": "row{s} without a time",
    "duplicate_stamps": "row{s} with a repeated time",
    "backward_stamps": "row{s} out of order in time",
    "bad_fixes": "position{s} with a large stated error",
    "blank_fixes": "row{s} without a position",
    "held_fixes": "repeated position{s}",
    "position_jumps": "position{s} out of reach",
    "position_breaks": "jump{s} to another position",
    "current_sign_flipped": "current{s} whose sign was changed",
    "power_sign_flipped": "power{s} whose sign was changed",
    "currents_as_magnitudes": "run{s} whose motor currents are summed as magnitudes",
    "currents_signed_by_wheels": "run{s} whose motor currents are signed by the wheel speeds",
    "reckoned_positions": "position{s} from wheel speeds",
}
"""What is not made a segment, and what is repaired or dropped in a log. What is said of a column has its name."""


def count_words(counts: Mapping[str, int]) -> str:
    """Return what of the runs is not made a segment, or what was repaired or dropped in a log.

    Result: such as "16 gaps, 2 voltage spikes"; empty where there is nothing.
    """

    def _words(key: str, count: int) -> str:
        s = "" if count == 1 else "s"
        if key.startswith("blank_") and key not in _COUNTS:
            return f"row{s} without {key.removeprefix('blank_').replace('_', ' ')}"
        if key.startswith("held_") and key not in _COUNTS:
            return f"row{s} that repeat{'' if s else 's'} a reading of {key.removeprefix('held_').replace('_', ' ')}"
        return _COUNTS.get(key, key.removesuffix("s").replace("_", " ") + "{s}").format(s=s)

    return ", ".join(f"{count:,} {_words(key, count)}" for key, count in counts.items() if count)


def quantity_name(key: str) -> str:
    """Return what a quantity that effects depend on is called. A logged column has its own name."""
    return _QUANTITIES[key][0] if key in _QUANTITIES else key.removeprefix("column:")


def quantity_words(key: str) -> tuple[str, str]:
    """Return the name and the unit of a quantity. The unit is empty where there is none, or where it is not known."""
    return quantity_name(key), _QUANTITIES.get(key, ("", ""))[1]


def quantity_value(key: str, value: float) -> str:
    """Return a value of a quantity with its unit."""
    unit = _QUANTITIES.get(key, ("", ""))[1]
    return f"{f'{value:.1f}' if key in _TENTHS else number_words(value)} {unit}".rstrip()


_ROUNDING = 1e-12
"""Less than what sums of double-precision numbers of some kilojoules are uncertain by, in any unit used here."""


def number_words(value: float, *, signed: bool = False) -> str:
    """Return a number with three significant digits; what is left of a difference by rounding is 0."""
    value = 0.0 if abs(value) < _ROUNDING else value
    rounded, sign = float(f"{value:.3g}"), "+" if signed else ""
    return f"{rounded:{sign},.0f}" if 1e3 <= abs(rounded) < 1e9 else f"{value:{sign}.3g}"
