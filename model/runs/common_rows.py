"""Columns that are series of their own at common stamps: topics of several rates, and logs of changes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.runs.table import FloatArray, TextArray

_PAUSE_PERIODS, _PAUSE_S = 5.0, 2.0  # no interpolation over more than five usual steps, and 2 s at least
_SPARSE = 0.5  # a column that is known in no more rows is a series of its own
_NEEDED = ("x", "y", "lat", "lon", "distance", "speed", "voltage", "current", "power", "energy", "charge", "soc")
_HELD = ("speed", "voltage", "current", "power", "soc")  # a counter and a position change evenly instead
_MOST_FILLED = 1e6  # rows of a log of changes, as of eleven days with one a second


def aligned(
    numbers: dict[str, FloatArray], rest: dict[str, FloatArray], texts: dict[str, TextArray]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray], dict[str, TextArray]]:
    """The columns at the stamps of the one that is known most often, where columns are series of their own.

    They are where some of what a run needs is blank in most rows, as in an export of topics of different rates.
    """
    every, t = {**rest, **numbers}, numbers["t"]
    parts = [key for key in (*numbers, *rest) if key.startswith("current_")]
    needed = [key for key in (*_NEEDED, *parts) if key in every and (key in numbers or key in parts)]
    needed = [key for key in needed if np.isfinite(every[key]).sum() > 1]
    held = [key for key in needed if key in _HELD or key.startswith("current_")]
    timed = np.isfinite(t)
    known = {key: np.isfinite(every[key]) & timed for key in needed}
    all_known = np.logical_and.reduce([timed, *known.values()])
    alone = any((each != all_known).any() for each in known.values())  # quantities do not change all at once
    if alone and _of_changes(t, [every[key] for key in held]):
        return _filled(numbers, rest, texts, held)
    if not known or float(all_known.mean()) > _SPARSE:
        return numbers, rest, texts
    rows = max(known.values(), key=np.sum)
    at = t[rows]

    def _at(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {key: at_stamps(at, t, v, turning=key in ("heading", "yaw")) for key, v in columns.items()}

    placed = _at({key: values for key, values in numbers.items() if key != "t"})
    return {"t": at} | placed, _at(rest), {key: values[rows] for key, values in texts.items()}


def _of_changes(t: FloatArray, written: Sequence[FloatArray]) -> bool:
    """Whether a log writes only what changes: in most of the time of one of the columns nothing, and in all no value
    twice in a row, but for the last.
    """
    if not any(_mostly_paused(t, values) for values in written):
        return False
    return not any((np.diff(values[_in_time(t, values)])[:-1] == 0).any() for values in written)


def _mostly_paused(t: FloatArray, values: FloatArray) -> bool:
    known = np.isfinite(t) & np.isfinite(values)
    steps = np.diff(t if known.all() else t[known])
    if steps.size and steps.min() < 0:
        steps = np.diff(np.sort(t[known]))
    return bool(steps.max(initial=0.0) > _PAUSE_S and 2 * steps[_pauses(steps)].sum() > steps.sum())


def _filled(
    numbers: Mapping[str, FloatArray],
    rest: Mapping[str, FloatArray],
    texts: Mapping[str, TextArray],
    held: Collection[str],
) -> tuple[dict[str, FloatArray], dict[str, FloatArray], dict[str, TextArray]]:
    """A log of changes with the rows that it leaves out: a value of `held` stays until the next is written."""
    order = _in_time(numbers["t"], numbers["t"])
    t = numbers["t"][order]
    every = {**rest, **numbers}
    stamps = np.unique(np.concatenate([numbers["t"][_in_time(numbers["t"], every[key])] for key in held]))
    step = float(np.median(np.diff(stamps)))
    if np.ptp(stamps) > _MOST_FILLED * step:  # a few rows with one stamp of a wrong clock
        return {**numbers}, {**rest}, {**texts}
    at = stamps[0] + step * np.arange(int(np.ptp(stamps) / step) + 1)

    def _at(key: str, values: FloatArray) -> FloatArray:
        if key not in held:
            return at_stamps(at, numbers["t"], values, turning=key in ("heading", "yaw"))
        rows = _in_time(numbers["t"], values)
        last = np.searchsorted(numbers["t"][rows], at + 1e-3 * step, side="right") - 1
        return np.where(last < 0, np.nan, values[rows][np.maximum(last, 0)])

    latest = order[np.searchsorted(t, at, side="right") - 1]
    filled = {key: _at(key, values) for key, values in numbers.items() if key != "t"}
    others = {key: _at(key, values) for key, values in rest.items()}
    return {"t": at} | filled, others, {key: values[latest] for key, values in texts.items()}


def _in_time(t: FloatArray, values: FloatArray) -> NDArray[np.int64]:
    """Rows of which both are known, in the order of time."""
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(values))
    return known[np.argsort(t[known], kind="stable")]


def _pauses(steps: FloatArray) -> NDArray[np.bool_]:
    return steps > max(_PAUSE_S, _PAUSE_PERIODS * float(np.median(steps))) if steps.size else steps > 0


def at_stamps(t: FloatArray, stamps: FloatArray, values: FloatArray, *, turning: bool) -> FloatArray:
    """Return values at other stamps, by straight lines.

    `t` (n,): where they are wanted [s]; `stamps`, `values` (m,): where they are known [s], and what they are, NaN where
    they are not; `turning`: whether they are angles [deg]. Result (n,): NaN in pauses and outside.
    """
    known = np.isfinite(stamps) & np.isfinite(values)
    order = np.argsort(stamps[known], kind="stable")
    stamps, values = stamps[known][order], values[known][order]
    first = np.concatenate([[True], np.diff(stamps) > 0]) if stamps.size else np.zeros(0, dtype=bool)
    stamps, values = stamps[first], values[first]
    if stamps.size < 2:
        return np.full(t.size, np.nan)
    if turning:
        values = np.degrees(np.unwrap(np.radians(values)))
    out = np.interp(t, stamps, values, left=np.nan, right=np.nan)
    steps = np.diff(stamps)
    pause = _pauses(steps)
    after = np.clip(np.searchsorted(stamps, t, side="left"), 1, stamps.size - 1)
    out[pause[after - 1] & (t != stamps[after]) & (t != stamps[after - 1])] = np.nan
    return out % 360.0 if turning else out
