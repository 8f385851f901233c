"""Which column is the time: by its name, then by how it rises, and how finely."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from joulemap.model.runs.agreement import epoch_of
from joulemap.model.runs.candidates import CONFIDENCE, Recognised, candidates_of, has_partner, surest
from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.names import POSSIBLE, Candidate
from joulemap.model.runs.table import FloatArray, known_values

_RISES = 0.5  # of the steps of a time, less those in which it falls


def choose_time(stream: Stream, found: Recognised) -> None:
    """Choose the time, which may be a date and a time of day."""
    candidates = candidates_of("t", stream, found.taken)
    tied = surest(candidates, stream.numbers)
    if len(tied) > 1:
        tied = _rising(tied, stream)
    if len(tied) == 1:
        tied = [_finer(tied[0], candidates, stream)]
    if len(tied) == 1 or [each.unit for each in tied] == [DATE, CLOCK]:
        found.take("t", tied)
    elif tied:
        found.ask("t", tied)
    else:
        _take_epoch(stream, found)


def _take_epoch(stream: Stream, found: Recognised) -> None:
    """Take the only column of stamps in milliseconds or less since 1970, whatever its name: nothing else is as large
    and rises.
    """
    stamps = [
        column
        for column, values in stream.numbers.items()
        if column not in found.taken and epoch_of(values) and abs(_rises(values)) > _RISES
    ]
    if len(stamps) == 1:
        found.take("t", [Candidate(stamps[0], epoch_of(stream.numbers[stamps[0]]), POSSIBLE)])


def take_axis(stream: Stream, found: Recognised) -> None:
    """Take a column called `x` that rises in every row and has no `y`, the axis of a plot, for the time in seconds."""
    known = {*found.chosen, *found.questions}
    if "t" in known:
        return
    only_x = "x" in found.chosen and "y" not in known
    taken = found.taken - {*found.chosen["x"].columns} if only_x else found.taken
    lone = [
        each.column
        for each in candidates_of("x", stream, taken)
        if each.unit in ("", "s") and not has_partner(each, stream) and _rises(stream.numbers[each.column]) == 1.0
    ]
    if len(lone) != 1:
        return
    column = lone[0]
    if only_x:
        del found.chosen["x"], found.confidence["x"]
    found.chosen["t"] = Source(((1, column),), "s")
    found.confidence["t"] = CONFIDENCE[POSSIBLE]
    found.notes.append(f"`t` is taken from {column[:60]}, in seconds: it rises, and there is no y")


def _rising(tied: Sequence[Candidate], stream: Stream) -> list[Candidate]:
    """A date with a time of day, or the columns of both; of plain numbers the one that rises in most rows."""
    dates, clocks = ([each for each in tied if each.unit == unit] for unit in (DATE, CLOCK))
    whole = [each for each in dates if _resolves(stream.numbers[each.column])]
    if whole or (dates and clocks):
        return whole[:1] or [dates[0], clocks[0]]
    known = {each: _rises(values := stream.numbers[each.column]) * np.isfinite(values).sum() for each in tied}
    best = max(tied, key=lambda each: known[each])
    return [best] if clocks or _rises(stream.numbers[best.column]) > _RISES else list(tied)


def _finer(usual: Candidate, candidates: Sequence[Candidate], stream: Stream) -> Candidate:
    """Beside a time that repeats, such as one in whole minutes, another that has at least twice as many values."""
    if len(candidates) == 1:
        return usual
    numbers = [stream.numbers[each.column] for each in candidates]
    count = {each: np.unique(known_values(v)).size for each, v in zip(candidates, numbers, strict=True)}
    most = max(candidates, key=lambda each: count[each] * (_rises(stream.numbers[each.column]) > _RISES))
    return most if count[most] >= 2 * count[usual] else usual


def _resolves(seconds: FloatArray) -> bool:
    """Whether these are more than dates."""
    known = known_values(seconds)
    return bool((known % 86_400.0 != known[:1] % 86_400.0).any())


def _rises(values: FloatArray) -> float:
    steps = np.diff(known_values(values))
    return float(np.mean(steps > 0)) - float(np.mean(steps < 0)) if steps.size else 0.0
