"""Times that a log writes as text: dates with a time of day in any usual order, and times of day alone."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_DAY_S = 86_400.0
_TIME_OF_DAY = re.compile(r"^(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?(?:\s*([AaPp])\.?[Mm]\.?)?$")
_MINUTES = re.compile(r"^(\d{1,3}):([0-5]\d[.,]\d{1,3})$")  # of a lap; degrees and minutes have more places
_ORDERED = re.compile(r"^(\d{1,2})([./-])(\d{1,2})\2(\d{2,4})\b")
_FRACTION = re.compile(r"(?<=\d\d:\d\d:\d\d)[.,:](\d+)")
_ISO = re.compile(r"^\d{4}-\d\d?-\d\d?")
_SPELT = re.compile(r"[A-Za-z]{3}|/|^\d{4}[/.]\d")  # a month as a word, or numbers with other marks between


def seconds_of(texts: Iterable[str | None], *, lenient: bool = False) -> tuple[FloatArray, int]:
    """Return times that were written as text.

    Result: seconds since 1970, or since midnight where there is no date, (n,), NaN where blank; and how many are no
    times.

    Of dates such as 05/31/2024 the month comes first if a day above 12 stands there in any of them, or with strokes;
    with points the day is first everywhere.
    """
    words = [(text or "").replace(" @ ", " ").strip() for text in texts]  # of Kibana
    ordered = [found for word in words if (found := _ORDERED.match(word))]
    day_first = any(found[2] == "." or int(found[1]) > 12 for found in ordered)
    if not day_first and ordered and all(found[2] == "-" for found in ordered):
        day_first = not any(int(found[3]) > 12 for found in ordered)
    seconds: list[float] = []
    wrong = 0
    for k, word in enumerate(words):
        try:
            seconds.append(_seconds(word, day_first))
        except (ValueError, OverflowError):
            if not lenient:
                raise ValueError(k) from None
            wrong += 1
            seconds.append(np.nan)
    return np.array(seconds, dtype=np.float64), wrong


def across_midnight(t: FloatArray) -> FloatArray:
    """Return times of day that go on counting after midnight.

    `t` (n,): seconds since midnight, NaN where blank. The result is (n,). A day is added where a time of day falls back
    by more than half a day.
    """
    known = np.flatnonzero(np.isfinite(t))
    days = np.cumsum(np.diff(t[known], prepend=t[known[:1]]) < -_DAY_S / 2)
    out = t.copy()
    out[known] += _DAY_S * days
    return out


def _seconds(text: str, day_first: bool) -> float:
    if not text:
        return np.nan
    if (lap := _MINUTES.match(text)) is not None:
        return 60.0 * int(lap[1]) + float(lap[2].replace(",", "."))
    clock = _TIME_OF_DAY.match(text)
    if clock is not None:
        hours, minutes = int(clock[1]), int(clock[2])
        if hours > 24 or minutes > 59:
            raise ValueError(text)
        if clock[4]:
            hours = hours % 12 + 12 * (clock[4] in "Pp")
        return 3600.0 * hours + 60.0 * minutes + float((clock[3] or "0").replace(",", "."))
    whole, fraction = _FRACTION.sub("", text, count=1), _FRACTION.search(text)  # Python reads six digits at most
    if _ISO.match(whole):
        when = dt.datetime.fromisoformat(whole.removesuffix(" UTC"))
    elif _ORDERED.match(whole) or (_SPELT.search(whole) and ":" in whole):
        from dateutil import parser

        when = parser.parse(whole, dayfirst=day_first)
    else:
        raise ValueError(text)
    if when.tzinfo is None:
        when = when.replace(tzinfo=dt.UTC)
    return when.timestamp() + (float(f"0.{fraction[1]}") if fraction is not None else 0.0)
