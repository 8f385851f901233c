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

_LEFT_OUT = {
    "gaps": ("gap", "gaps"),
    "stops": ("stop", "stops"),
    "remainders": ("piece too short for a segment", "pieces too short for a segment"),
    "bent": ("where the path bends too much", "where the path bends too much"),
    "slow": ("where the robot was much slower than usual", "where the robot was much slower than usual"),
    "fast": ("where the robot was faster than it can drive", "where the robot was faster than it can drive"),
    "not_positive": ("where the measured energy is not above zero", "where the measured energy is not above zero"),
    "undriven": ("of a run in which the robot was carried", "of runs in which the robot was carried"),
}
"""What is not made a segment: for one, and for several."""

_REPAIRS = {
    "truncated_rows": ("incomplete last row", "incomplete last rows"),
    "rows_without_time": ("row without a time", "rows without a time"),
    "duplicate_stamps": ("row with a repeated time", "rows with a repeated time"),
    "backward_stamps": ("row out of order in time", "rows out of order in time"),
    "bad_fixes": ("position with a large stated error", "positions with a large stated error"),
    "blank_fixes": ("row without a position", "rows without a position"),
    "held_fixes": ("repeated position", "repeated positions"),
    "position_jumps": ("position out of reach", "positions out of reach"),
    "position_breaks": ("jump to another position", "jumps to another position"),
    "current_sign_flipped": ("current whose sign was changed", "currents whose sign was changed"),
    "power_sign_flipped": ("power whose sign was changed", "powers whose sign was changed"),
    "currents_as_magnitudes": ("run whose motor currents are summed as magnitudes",) * 2,
    "currents_signed_by_wheels": ("run whose motor currents are signed by the wheel speeds",) * 2,
    "reckoned_positions": ("position from wheel speeds", "positions from wheel speeds"),
}
"""What is repaired or dropped in a log: for one, and for several. Blanks and spikes carry the column's name."""


def left_out_words(counts: Mapping[str, int]) -> str:
    """Return what of the runs is not made a segment.

    Parameters
    ----------
    counts : mapping of str to int
        Key, as in `Segments.left_out` -> count.

    Returns
    -------
    str
        Such as "16 gaps, 24 stops"; empty where nothing is left out.
    """
    return _count_words(counts, _LEFT_OUT)


def repair_words(counts: Mapping[str, int]) -> str:
    """Return what was repaired or dropped in a log.

    Parameters
    ----------
    counts : mapping of str to int
        Key, as in `Run.repairs` -> count.

    Returns
    -------
    str
        Such as "9 repeated positions, 2 voltage spikes"; empty where nothing was.
    """
    return _count_words(counts, _REPAIRS)


def _count_words(counts: Mapping[str, int], table: Mapping[str, tuple[str, str]]) -> str:
    def words(key: str, count: int) -> str:
        if key in table:
            return table[key][count != 1]
        if key.startswith("blank_"):
            return f"{'row' if count == 1 else 'rows'} without {key.removeprefix('blank_').replace('_', ' ')}"
        plain = key.replace("_", " ")
        return plain.removesuffix("s") if count == 1 else plain

    return ", ".join(f"{count:,} {words(key, count)}" for key, count in counts.items() if count)


def p_words(p_value: float) -> str:
    """Return a p-value with its relation, to be written after "p".

    Parameters
    ----------
    p_value : float
        Of a significance test.

    Returns
    -------
    str
        Such as "= 0.02", or "< 1e-9": smaller ones rest on the far tail of a distribution, which no data can check.
    """
    return "< 1e-9" if p_value < 1e-9 else f"= {p_value:.2g}"


def quantity_name(key: str) -> str:
    """Return what a quantity that effects depend on is called.

    Parameters
    ----------
    key : str
        As `joulemap.model.runs.features.quantity` takes it.

    Returns
    -------
    str
        A logged column has its own name.
    """
    return _QUANTITIES[key][0] if key in _QUANTITIES else key.removeprefix("column:")


def quantity_words(key: str) -> tuple[str, str]:
    """Return the name and the unit of a quantity.

    Parameters
    ----------
    key : str
        As `quantity_name` takes it.

    Returns
    -------
    tuple of str
        The unit is empty where there is none, or where it is not known.
    """
    return quantity_name(key), _QUANTITIES.get(key, ("", ""))[1]


def quantity_value(key: str, value: float) -> str:
    """Return a value of a quantity with its unit.

    Parameters
    ----------
    key : str
        As `joulemap.model.runs.features.quantity` takes it.
    value : float
        As that function returns it.

    Returns
    -------
    str
        Such as "0.5 m/s".
    """
    unit = _QUANTITIES.get(key, ("", ""))[1]
    return f"{value:{'.1f' if key in _TENTHS else '.3g'}} {unit}".rstrip()
