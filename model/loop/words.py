"""The one table from the keys of effects and quantities to the words that a reader sees.

Files, reports and options keep the keys; pages, messages and the command line show the words.
"""

from __future__ import annotations

from collections.abc import Mapping

LEAST_P = 0.001
"""The smallest p-value that the permutation tests can give, see `joulemap.model.loop.chance.SHIFTS`."""

EFFECTS = {
    "acceleration": "acceleration",
    "battery": "internal resistance of the battery",
    "braking": "downhill braking",
    "climbing": "climbing",
    "cross_slope": "cross slope",
    "drift": "drift over time or distance",
    "hotel_load": "idle power",
    "local_friction": "local rolling resistance",
    "payload": "payload",
    "reversing": "driving backwards",
    "rolling_resistance": "rolling resistance",
    "sensor_gain": "sensor gain",
    "speed": "speed",
    "temperature": "temperature",
    "terrain_class": "terrain class",
    "turning": "turning",
    "wind": "wind",
    "learned:cross_slope": "cross slope (fitted curve)",
    "learned:heading": "heading (fitted curve)",
    "learned:hollow": "topographic position index (fitted curve)",
    "learned:place": "position on the map (fitted field)",
    "learned:roughness": "roughness",
    "level": "constant factor",
    "standing": "power while stationary",
}
"""Names of effects by key."""

_QUANTITIES = {
    "clock": ("time since the first run began", "s"),
    "cross_slope": ("cross slope", ""),
    "driven": ("distance driven in the run", "m"),
    "elevation": ("elevation", "m"),
    "grade": ("grade", ""),
    "hollow": ("topographic position index", "m"),
    "odometer": ("distance driven since the first run", "m"),
    "roughness": ("roughness", "m"),
    "since_start": ("time since the start of the run", "s"),
    "speed": ("speed", "m/s"),
    "turn": ("heading change per segment, positive to the right", "rad"),
    "turning": ("heading change per segment", "rad"),
    "x": ("x", "m"),
    "y": ("y", "m"),
    "column:temperature": ("temperature", "degC"),
    "column:motor_temperature": ("motor_temperature", "degC"),
    "column:wind_speed": ("wind_speed", "m/s"),
    "column:wind_from": ("wind_from", "deg"),
    "column:roll": ("roll", "deg"),
    "column:pitch": ("pitch", "deg"),
    "column:payload": ("payload", "kg"),
}
"""Name and unit of what effects depend on. The unit of other logged columns is not known."""

_TENTHS = frozenset({"elevation", "x", "y"})  # may be large, and their differences small

_MEANINGS = {
    "acceleration": "mass whose energy of motion is not recovered when the robot slows down",
    "battery": "resistance in which energy is lost with the square of the current",
    "braking": "share of the energy released downhill that the battery supplies on top",
    "climbing": "share of the energy of climbing that is added",
    "cross_slope": "coefficient of rolling resistance added per tangent of the cross slope",
    "disk": "coefficient of rolling resistance that is added inside the circle",
    "friction": "added coefficient of rolling resistance",
    "drift": "energy added per hour or per kilometre",
    "heading": "energy added by heading, as sine and cosine terms",
    "hotel_load": "power drawn all the time, in addition to the declared idle power",
    "payload": "mass in addition to the declared mass",
    "reversing": "energy added while driving backwards",
    "place": "coefficient of rolling resistance, or share of all energy, added at each centre of the field",
    "roughness": "coefficient of rolling resistance added per metre of roughness",
    "sensor_gain": "share by which everything measured is larger than predicted",
    "speed": "energy per metre that is added with speed",
    "temperature": "energy or power added per degree above the reference temperature",
    "turning": "energy per radian of heading change",
    "turning_both": "energy per radian of heading change",
    "turning_sides": "energy per radian of heading change, to each side",
    "turning_words": "energy per radian of heading change, added on each class of ground",
    "wind_constant": "energy per metre added when driving east and north against the wind",
    "wind_measured": "drag added per unit of relative air speed",
    "words": "energy added on each class of ground",
}


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
        Such as "= 0.02". A permutation test cannot find less than one of its permutations: "<= 0.001".
    """
    return f"<= {LEAST_P:g}" if p_value <= LEAST_P else f"= {p_value:.2g}"


def effect_name(key: str) -> str:
    """Return what an effect is called.

    Parameters
    ----------
    key : str
        As it is in a report, like `learned:grade`.

    Returns
    -------
    str
        A fitted curve over a logged column has the column's own name; an unknown key is returned as it is.
    """
    if key in EFFECTS:
        return EFFECTS[key]
    if key.startswith("learned:"):
        return f"{key.removeprefix('learned:')} (fitted curve)"
    if key.startswith("terrain_class:"):
        return f"class of {key.removeprefix('terrain_class:')}"
    first, by, second = key.partition(" x ")
    return f"{effect_name(first)} by {effect_name(second)}" if by else key


def quantity_name(key: str) -> str:
    """Return what a quantity that effects depend on is called.

    Parameters
    ----------
    key : str
        As `joulemap.model.loop.formulas.quantity` takes it.

    Returns
    -------
    str
        A logged column has its own name.
    """
    return _QUANTITIES[key][0] if key in _QUANTITIES else key.removeprefix("column:")


def quantity_value(key: str, value: float) -> str:
    """Return a value of a quantity with its unit.

    Parameters
    ----------
    key : str
        As `joulemap.model.loop.formulas.quantity` takes it.
    value : float
        As that function returns it.

    Returns
    -------
    str
        The depth of a place below its surroundings is written as a topographic position index, which is negative there.
    """
    shown = -value if key == "hollow" else value
    unit = _QUANTITIES.get(key, ("", ""))[1]
    return f"{shown:{'.1f' if key in _TENTHS else '.4g'}} {unit}".rstrip()


def coefficient_meaning(formula: str) -> str:
    """Return what the coefficients of a formula mean.

    Parameters
    ----------
    formula : str
        Name of the formula.

    Returns
    -------
    str
        Empty for a formula whose coefficients mean something together only.
    """
    return _MEANINGS.get(formula, "")
