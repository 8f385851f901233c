"""Counters: energy or charge since the start, which may begin anew; distance counted, or summed from the speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RunsError
from joulemap.model.runs.table import FloatArray, known_values

BoolArray = NDArray[np.bool_]

_RESET_SHARE = 0.1  # a counter that begins anew falls to less than this share of what it was
LONGEST_STEP = 10.0  # usual steps between rows, and 10 s at least: over more nothing is summed


def total_of(counter: FloatArray) -> FloatArray:
    """Return what a counter counted since the first row.

    `counter` (n,): NaN where it was not read. Result (n,): without its new beginnings; rising where it fell all the
    time, as what is left does.
    """
    known = np.flatnonzero(np.isfinite(counter))
    out = np.full(counter.size, np.nan)
    if not known.size:
        return out
    values = counter[known]
    steps = np.diff(values)
    usual = float(np.quantile(np.abs(steps), 0.99)) if steps.size else 0.0
    anew = (steps < 0) & (np.abs(values[1:]) < _RESET_SHARE * np.abs(values[:-1])) & (-steps > 5.0 * usual)
    steps = np.where(anew, np.clip(values[1:], 0.0, usual), steps)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    out[known] = total if total[-1] >= 0 else -total
    return out


def rate_of(t: FloatArray, total: FloatArray) -> FloatArray:
    """Return how fast a total rises, so that straight lines between rows have its sum.

    `t` (n,): stamps [s]; `total` (n,): as `total_of` returns it. Result (n,): per second, between rows at which the
    counter changes; NaN before the first and after the last row that is known, and where stamps do not rise.
    """
    known = np.isfinite(t) & np.isfinite(total)
    rows = np.flatnonzero(known)
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(t[rows])) > 0]) if rows.size else known[:0]
    rows = rows[rising]
    out = np.full(t.size, np.nan)
    if rows.size < 2:
        return out
    changes = np.concatenate([[True], np.diff(total[rows]) != 0])
    changes[-1] = True
    at = np.interp(t[rows], t[rows][changes], total[rows][changes])
    steps, dt = np.diff(at), np.diff(t[rows])  # over both steps beside a row, whose trapezoids have the whole sum
    both = [np.append(each, 0.0) + np.concatenate([[0.0], each]) for each in (steps, dt)]
    out[rows] = both[0] / both[1]
    return out


def summed(t: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the distance that a speed makes.

    `t` (n,): stamps [s]; `speed` (n,): its sign does not count [m/s], NaN where it was not read. Result (n,): from the
    first row [m]; NaN in rows without a time.
    """
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(speed))
    out = np.full(t.size, np.nan)
    if known.size < 2:
        return out
    dt, fast = np.diff(t[known]), np.abs(speed[known])
    dt = np.where(_pause(dt), 0.0, dt)
    out[known] = np.concatenate([[0.0], np.cumsum(0.5 * (fast[1:] + fast[:-1]) * np.maximum(dt, 0.0))])
    return out


def unknown_s(t: FloatArray, speed: FloatArray) -> float:
    """Return for how long `summed` sums nothing, though the vehicle drove before or after [s]."""
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(speed))
    dt, fast = np.diff(t[known]), np.abs(speed[known])
    return float(dt[_pause(dt) & (np.maximum(fast[1:], fast[:-1]) > 0)].sum())


def pauses(dt: FloatArray, usual: float) -> BoolArray:
    """Return which steps of time are so much longer than usual that nothing is known of what was driven in them."""
    return dt > max(LONGEST_STEP * usual, 10.0)


def _pause(dt: FloatArray) -> BoolArray:
    return pauses(dt, float(np.median(dt[dt > 0])) if (dt > 0).any() else 0.0)


def is_per_row(counter: FloatArray) -> bool:
    """Return whether a column rises and falls so much more than it gains that it counts nothing, but says what came
    since the row before. `counter` (n,): NaN where it was not read.
    """
    known = known_values(counter)
    steps = np.diff(known)
    return bool(known.size > LONGEST_STEP and np.abs(steps).sum() > LONGEST_STEP * np.ptp(known) > 0)


def no_counter(name: str, target: str, column: str, unit: str) -> RunsError:
    """Return the error of a column that should count, and does not, with the mapping that says what it may be."""
    return RunsError.of_run(
        name,
        f"{column[:60]} rises and falls again and again, so it does not count from the begin: if it is what came since "
        f"the row before, say so with a mapping, {target}={column[:60]}:{unit}/row",
        column=target,
    )
