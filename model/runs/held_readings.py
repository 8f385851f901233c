"""Readings of a meter that is slower than the log, which repeats each of them until the next.

A current that is read once a second and written twenty times a second has steps that nothing drew: up to a second after
a turn begins, its energy is that of the straight metre before. Between two readings the value is taken to change evenly
instead, as between the messages of two streams (`joulemap.model.runs.logs`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_LONGEST_S = 5.0
"""A value that stays for longer does not change, as at rest."""
_LEAST_ROWS = 5
"""In a period: the steps of a faster meter are too short to matter."""
_LEAST_READINGS = 10
"""That stay for about as long, before a meter is taken for slow."""


def between_readings(t: FloatArray, values: FloatArray) -> tuple[FloatArray, int]:
    """Return the values of a slow meter as they change between its readings.

    `t` (n,): stamps [s], strictly increasing; `values` (n,). Result: straight lines from reading to reading, each at
    the first row that has it; and the number of rows that repeat one. The same values and 0 where the meter is not
    slower than the log: where values do not stay for as long again and again.

    The sum of two meters that are read one after the other has short steps between the two readings. A value that
    stays for less than half a period is such a step, and no reading.
    """
    known = np.flatnonzero(np.isfinite(values))
    if known.size < _LEAST_READINGS:
        return values, 0
    first = known[np.concatenate([[True], np.diff(values[known]) != 0.0])]
    ends = np.append(t[first[1:]], t[known[-1]])
    stays = ends - t[first]
    row = float(np.median(np.diff(t)))
    period = _usual(stays[stays <= _LONGEST_S])
    alike = np.abs(stays - period) <= row + 0.1 * period
    if period < _LEAST_ROWS * row or alike.sum() < _LEAST_READINGS:
        return values, 0
    if stays[alike].sum() < 0.5 * stays[stays <= _LONGEST_S].sum():
        return values, 0
    reading = stays >= 0.5 * period
    again = stays > 1.5 * period  # the same was read again, the last time a period before it changed
    at = np.append(t[first[reading]], ends[again] - period)
    said = np.append(values[first[reading]], values[first[again]])
    order = np.argsort(at, kind="stable")
    out = values.copy()
    out[known] = np.interp(t[known], at[order], said[order])
    return out, int(known.size - first.size)


def _usual(stays: FloatArray) -> float:
    """For how long the value stays that a row has in the median [s]; 0 without any."""
    if stays.size == 0:
        return 0.0
    order = np.sort(stays)
    return float(order[np.searchsorted(np.cumsum(order), 0.5 * order.sum())])
