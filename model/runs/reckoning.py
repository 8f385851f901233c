"""Positions between fixes from logged wheel speeds, where both ends show that the wheels tell the way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import wrap_angle
from joulemap.model.runs.table import SIDES, TURNING, add_count

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

WHEELS = (SIDES, ("velL", "velR"), TURNING)
"""Pairs of columns of wheel speeds, in m/s or rad/s."""

_MISCLOSURE_M = 0.5  # half a segment: a place that is further off belongs to another one
_LAG_S = 1.0  # over which wheels and positions are compared: long beside the noise of fixes, short beside a manoeuvre
_BLANK_INTERVALS = 2.5  # as for missing rows: more than one fix is missing


def sides_of(columns: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray] | None:
    """Return the wheel speeds of both sides.

    `columns` (n,): columns of a log. Result (n,): left and right, in the unit of the log, blanks bridged; None if they
    are not logged in at least 80 % of the rows.
    """
    for pair in WHEELS:
        if all(key in columns and np.isfinite(columns[key]).mean() >= 0.8 for key in pair):
            return without_blanks(columns[pair[0]]), without_blanks(columns[pair[1]])
    return None


def without_blanks(values: FloatArray) -> FloatArray:
    """Return values with blanks filled on straight lines.

    `values` (n,): NaN where there is none. The result is (n,).
    """
    known = np.isfinite(values)
    rows = np.arange(values.size)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(values.size)


def fill_by_wheels(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    breaks: BoolArray,
    columns: dict[str, FloatArray],
    repairs: dict[str, int],
) -> tuple[FloatArray, FloatArray]:
    """Fill blanks of the position by dead reckoning.

    What a wheel's unit is in metres, and how far a difference of the sides turns the robot, is estimated where there
    are fixes. In a blank the wheels give the shape of the way; it is rotated and scaled to meet the fixes at both ends.
    It is used if its chord is as long as theirs to half a metre. A heading that is held in the blank, as by the same
    sensor, turns as the wheels do from its value before to that after.

    `t`, `x`, `y` (n,): stamps [s] and positions [m], NaN where there is none; `breaks` (n,): True where the position
    jumps; `columns` (n,): the others, `heading` [deg] is replaced. Result (n,): x, y [m].
    """
    sides = sides_of(columns)
    fixes = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    moved = np.hypot(np.diff(x[fixes]), np.diff(y[fixes])) > 0
    if sides is None or not moved.any():
        return x, y
    dt = np.diff(t, prepend=t[0])
    rolled, differed = (np.cumsum(part * dt) for part in ((sides[0] + sides[1]) / 2, sides[0] - sides[1]))
    longest = _BLANK_INTERVALS * float(np.median(np.diff(t[fixes])[moved]))
    blank = (np.diff(t[fixes]) > longest) & (np.diff(fixes) > 1)
    if not blank.any():
        return x, y
    heading = columns.get("heading")
    turns = None if heading is None or np.isnan(heading).any() else np.unwrap(np.radians(heading))
    metres, radians = _scales(t, x, y, fixes, blank, rolled, differed, turns)
    if metres == 0:
        return x, y
    x, y, count = x.copy(), y.copy(), 0
    for i in np.flatnonzero(blank):
        first, last = fixes[i], fixes[i + 1]
        if breaks[first + 1 : last + 1].any():
            continue
        rows = slice(first, last + 1)
        angle = radians * (differed[rows] - differed[first])
        ahead = metres * np.diff(rolled[rows])
        way = np.concatenate([[0.0], np.cumsum(ahead * np.exp(0.5j * (angle[1:] + angle[:-1])))])
        chord = complex(y[last] - y[first], x[last] - x[first])  # north is real: angles are clockwise from it
        if abs(abs(way[-1]) - abs(chord)) > _MISCLOSURE_M or abs(way[-1]) < _MISCLOSURE_M:
            continue
        way *= chord / way[-1]
        inner = slice(first + 1, last)
        x[inner], y[inner] = x[first] + way.imag[1:-1], y[first] + way.real[1:-1]
        count += last - first - 1
        if turns is not None and np.ptp(turns[first:last]) == 0:
            missed = wrap_angle(turns[last] - turns[first] - angle[-1]) * (t[rows] - t[first]) / (t[last] - t[first])
            columns["heading"] = columns["heading"].copy()
            columns["heading"][inner] = np.degrees(turns[first] + angle + missed)[1:-1] % 360.0
    add_count(repairs, "reckoned_positions", count)
    return x, y


def _scales(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    fixes: NDArray[np.int64],
    blank: BoolArray,
    rolled: FloatArray,
    differed: FloatArray,
    turns: FloatArray | None,
) -> tuple[float, float]:
    """Metres per unit rolled and radians per unit of difference, by least squares over spans of about a second."""
    after = np.searchsorted(t[fixes], t[fixes] + _LAG_S)
    first = np.flatnonzero(after < fixes.size)
    after = after[first]
    blanks = np.concatenate([[0], np.cumsum(blank)])
    whole = blanks[after] == blanks[first]
    a, b = fixes[first[whole]], fixes[after[whole]]
    way = np.abs(rolled[b] - rolled[a])
    if not (way > 0).any():
        return 0.0, 0.0
    metres = float((np.hypot(x[b] - x[a], y[b] - y[a]) * way).sum() / (way**2).sum())
    difference = differed[b] - differed[a]
    if turns is None or not difference.any():
        return metres, 0.0
    return metres, float(((turns[b] - turns[a]) * difference).sum() / (difference**2).sum())
