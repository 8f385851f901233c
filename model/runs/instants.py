"""Times that a log writes as text: dates with a time of day (ISO 8601 and close to it), and times of day alone."""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_DAY_S = 86_400.0
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})")  # with points the day is first everywhere
_YEAR_FIRST = re.compile(r"^(\d{4})/(\d{1,2})/(\d{1,2})")
_TIME_OF_DAY = re.compile(r"^(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?$")
_FRACTION = re.compile(r"[.,](\d+)")


def seconds_of(texts: Iterable[str]) -> FloatArray:
    """Return times that were written as text.

    Parameters
    ----------
    texts : iterable of str
        Such as "2024-05-01T12:00:00.25Z", "01.05.2024 12:00:00,25", "2024-05-01" or "12:00:00.25". Without a time zone
        they are taken as UTC.

    Returns
    -------
    ndarray of float, (n,)
        Seconds since 1970, or since midnight where there is no date; NaN where blank.

    Raises
    ------
    ValueError
        If one is no such time; its argument is the number of the first, from 0.
    """
    found = []
    for k, text in enumerate(texts):
        try:
            found.append(_seconds(text.strip()))
        except ValueError:
            raise ValueError(k) from None
    return np.array(found, dtype=np.float64)


def across_midnight(t: FloatArray) -> FloatArray:
    """Return times of day that go on counting after midnight.

    Parameters
    ----------
    t : ndarray of float, (n,)
        Seconds since midnight, NaN where blank.

    Returns
    -------
    ndarray of float, (n,)
        A day is added where a time of day falls back by more than half a day.
    """
    known = np.flatnonzero(np.isfinite(t))
    days = np.cumsum(np.diff(t[known], prepend=t[known[:1]]) < -_DAY_S / 2)
    out = t.copy()
    out[known] += _DAY_S * days
    return out


def _seconds(text: str) -> float:
    if not text:
        return math.nan
    clock = _TIME_OF_DAY.match(text)
    if clock is not None:
        hours, minutes = int(clock[1]), int(clock[2])
        return 3600.0 * hours + 60.0 * minutes + float((clock[3] or "0").replace(",", "."))
    text = _DAY_FIRST.sub(lambda m: f"{m[3]}-{int(m[2]):02d}-{int(m[1]):02d}", text)
    text = _YEAR_FIRST.sub(lambda m: f"{m[1]}-{int(m[2]):02d}-{int(m[3]):02d}", text)
    whole, fraction = _FRACTION.sub("", text, count=1), _FRACTION.search(text)  # Python reads six digits at most
    when = dt.datetime.fromisoformat(whole.removesuffix(" UTC"))
    if when.tzinfo is None:
        when = when.replace(tzinfo=dt.UTC)
    return when.timestamp() + (float(f"0.{fraction[1]}") if fraction is not None else 0.0)
