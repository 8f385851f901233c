"""What logs of messages share: values by topic, within limits, and faults of a reader as errors with their place."""

from __future__ import annotations

import errno
import struct
import sys
import threading
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from joulemap.model.errors import JoulemapError, RunsError, TooLargeError
from joulemap.model.runs.formats.contract import Log, Stream
from joulemap.model.runs.table import FloatArray, TableLimits

_SAME_CLOCK_S = 5.0  # a stamp of the sender is believed if it is usually this near to the time of recording
_MOST_COMPLAINTS = 200


@dataclass
class _Topic:
    recorded: array[float] = field(default_factory=lambda: array("d"))
    sent: array[float] = field(default_factory=lambda: array("d"))
    values: dict[str, array[float]] = field(default_factory=dict)


class Collector:
    """Collects the values of messages as they are read."""

    def __init__(self, name: str, limits: TableLimits) -> None:
        self._name = name
        self._limits = limits
        self._topics: dict[str, _Topic] = {}
        self._cells = 0
        self.messages = 0

    def add(self, topic: str, recorded_s: float, values: Mapping[str, float], sent_s: float = float("nan")) -> None:
        """Take the values of one message."""
        found = self._topics.setdefault(topic, _Topic())
        before = len(found.recorded)
        found.recorded.append(recorded_s)
        found.sent.append(sent_s)
        for key, value in values.items():
            column = found.values.get(key)
            if column is None:
                column = found.values[key] = array("d", [float("nan")]) * before
                self._limits.check(0, len(found.values), self._name)
            column.append(value)
        for column in found.values.values():
            if len(column) <= before:
                column.append(float("nan"))
        self.messages += 1
        self._cells += 2 + len(found.values)
        if before + 1 > self._limits.rows or self._cells > self._limits.cells:
            raise TooLargeError.of_run(
                self._name,
                f" has more than {before:,} messages of {topic} and {self._cells:,} values in all, the "
                f"limits are {self._limits.rows:,} and {self._limits.cells:,}: split it",
                rows=before + 1,
                limit=self._limits.rows,
            )

    def streams(self) -> tuple[Stream, ...]:
        """Return what was collected.

        Result: one for each topic; a column's name is `topic.field`. Stamps are those of the senders where their clock
        is that of the recording.
        """
        return tuple(
            Stream(
                topic,
                {f"{topic}.{key}": np.frombuffer(values, dtype=np.float64) for key, values in found.values.items()},
                {},
                _stamps(found),
            )
            for topic, found in self._topics.items()
        )


def _stamps(topic: _Topic) -> FloatArray:
    recorded, sent = np.array(topic.recorded), np.array(topic.sent)
    away = np.abs(sent - recorded)
    return sent if np.isfinite(away).all() and np.median(away) < _SAME_CLOCK_S else recorded


Wanted = Mapping[str, Sequence[str]]
"""By joulemap's column, where it may be found, the best first: `BATTERY_STATUS.voltage:mV`."""

PREFERRED = (("lat", "lon"), ("x", "y"))
"""Positions in degrees come before those in metres."""


def wanted_of(table: Mapping[str, str]) -> Wanted:
    """Return where columns may be found, of texts with spaces between."""
    return {target: places.split() for target, places in table.items()}


def fields_by_kind(wanted: Wanted) -> dict[str, set[str]]:
    """Return the fields that are wanted of each kind of message."""
    found: dict[str, set[str]] = {}
    for place in chain.from_iterable(wanted.values()):
        kind, _, name = place.rpartition(":")[0].partition(".")
        found.setdefault(kind, set()).add(name)
    return found


def log_of(streams: Sequence[Stream], wanted: Wanted, *, notes: Sequence[str] = ()) -> Log:
    """Return a log in which columns are found by the types of messages.

    Result: one of each column the first candidate that is mostly known; of candidates of one kind that with most
    values.
    """
    known = {
        column: int(np.isfinite(values).sum()) if np.isfinite(values).mean() > 0.5 else 0
        for stream in streams
        for column, values in stream.numbers.items()
        if values.size
    }
    usual: dict[str, str] = {}
    others: dict[str, tuple[str, ...]] = {}
    for target, candidates in wanted.items():
        found = [each for each in candidates if known.get(each.rpartition(":")[0], 0) > 1]
        if found:
            usual[target] = found[0]
            if len(found) > 1:
                others[target] = tuple(each.rpartition(":")[0] for each in found[1:4])
    complete = next((group for group in PREFERRED if all(target in usual for target in group)), ())
    for group in PREFERRED:
        for target in group:
            if target not in complete:
                usual.pop(target, None)
                others.pop(target, None)
    there = tuple(stream for stream in streams if stream.t is not None and stream.t.size)
    return Log(there, usual, others, tuple(notes))


@contextmanager
def reading(kind: str, name: str, place: Callable[[], str], *, repair: str = "") -> Iterator[None]:
    """Turn whatever a library raises on a broken file into an error that says where, and keep it from printing."""
    try:
        with _heard():
            yield
    except (JoulemapError, ImportError):
        raise
    except MemoryError as error:
        raise TooLargeError.of_run(
            name,
            f"the {kind} asks for more memory than there is, {place()}: it is corrupt, or much larger "
            "inside than outside",
        ) from error
    except OSError as error:
        # a place that no file has is a fault of the content
        if error.errno not in (None, errno.EINVAL, errno.EOVERFLOW):
            raise
        raise _broken(kind, name, place(), error, repair) from error
    except Exception as error:  # what a library raises on a broken file is not documented
        raise _broken(kind, name, place(), error, repair) from error


def _broken(kind: str, name: str, place: str, error: Exception, repair: str) -> RunsError:
    words = str(error).strip().split("\n")[0][:200] if not isinstance(error, KeyError) else f"unknown {error}"
    what = (
        "ends too early" if isinstance(error, (EOFError, struct.error)) or "EndOfFile" in type(error).__name__ else ""
    )
    return RunsError(
        f"run {name}: the {kind} is truncated or corrupt {place}: {what or words or type(error).__name__}"
        + (f". `{repair}` may repair it" if repair else ""),
        run=name,
        place=place,
    )


class _Complaints:
    """Takes what a library prints about a broken file; too much of it ends the reading."""

    def __init__(self) -> None:
        self._lines = 0
        self._first = ""

    def write(self, text: str) -> int:
        """Count a line. Raises ValueError after too many."""
        if text.strip():
            self._first = self._first or text.strip()
            self._lines += 1
            if self._lines > _MOST_COMPLAINTS:
                raise ValueError(f"{self._first} (and {_MOST_COMPLAINTS} more of these)")
        return len(text)


class _Switch:
    """In place of a standard stream while any thread reads: only what such a thread prints does not get through."""

    def __init__(self, beyond: Any) -> None:
        self.beyond = beyond

    def write(self, text: str) -> int:
        """Pass a text on, or keep it from the stream."""
        return (getattr(_hearing, "said", None) or self.beyond).write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.beyond, name)


_hearing = threading.local()  # what hears this thread while it reads a log
_readings = 0  # of all threads, now
_lock = threading.Lock()


@contextmanager
def _heard() -> Iterator[None]:
    """Hear what this thread prints; the standard streams come back with the last thread that reads."""
    global _readings
    outer, _hearing.said = getattr(_hearing, "said", None), _Complaints()
    with _lock:
        _readings += 1
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name)
            if not (stream is None or isinstance(stream, _Switch)):
                setattr(sys, name, _Switch(stream))
    try:
        yield
    finally:
        _hearing.said = outer
        with _lock:
            _readings -= 1
            for name in ("stdout", "stderr") if not _readings else ():
                stream = getattr(sys, name)
                setattr(sys, name, stream.beyond if isinstance(stream, _Switch) else stream)


def cut_off(kind: str, at: int, size: int) -> str:
    """Return the note of a log whose last record is not whole, because the robot was switched off for example.

    `at`: where the record begins [bytes]; `size`: length of the file [bytes].
    """
    where = f"in the middle of a record that begins at byte {at:,} of {size:,}" if at < size else f"at byte {size:,}"
    return f"the {kind} was cut off: it ends {where}. What comes before is kept"
