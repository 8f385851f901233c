"""What a format of logs consists of: a line in the registry, and a module that recognises and decodes its files.

A table (CSV, Parquet) is one stream, whose stamps are one of its columns. A log of messages (a bag, a flight log) has a
stream for each topic, with stamps of its own. `joulemap.model.runs.logs` makes a run's table of either.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

from joulemap.model.errors import RunsError
from joulemap.model.source_file import SourceFile

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from joulemap.model.runs.table import FloatArray, TableLimits

HEAD_BYTES = 512
"""First bytes of a file, by which its format is recognised."""


@dataclass(frozen=True)
class Stream:
    """Values that were logged together.

    Attributes
    ----------
    name : str
        The topic or the kind of message; empty for a table.
    numbers : dict of str to ndarray of float, (n,)
        Columns of numbers by their full names, such as `/battery.voltage`; NaN is blank.
    texts : dict of str to ndarray of str, (n,)
        Columns of text.
    t : ndarray of float, (n,), optional
        Stamps [s]; None where they are one of the columns.
    units : dict of str to str
        Of columns, where the file gives them separately from the name.
    unread : dict of str to int
        By column of numbers, how many of its cells are none.
    packs : tuple of (str, str)
        Columns of the voltage and the current of batteries in parallel, where the file says so.
    """

    name: str
    numbers: dict[str, FloatArray]
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    t: FloatArray | None = None
    units: dict[str, str] = field(default_factory=dict)
    unread: dict[str, int] = field(default_factory=dict)
    packs: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Log:
    """What a file holds, before its columns have joulemap's names and units.

    Attributes
    ----------
    streams : tuple of Stream
        At least one.
    usual : dict of str to str
        By joulemap's column, where it is found because of the type of a message: as a mapping writes it.
    others : dict of str to tuple of str
        By joulemap's column, further places where it could be taken from.
    notes : tuple of str
        What is to be known of the file: that it was cut off, for example.
    packs : tuple of (str, str)
        Columns of the voltage and the current of batteries in parallel, whose powers add; empty for one battery.
    """

    streams: tuple[Stream, ...]
    usual: Mapping[str, str] = field(default_factory=dict)
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    packs: tuple[tuple[str, str], ...] = ()


class LogModule(Protocol):
    """The functions of a format's module."""

    def recognise(self, head: bytes, name: str) -> bool:
        """Decide whether a file is of this format."""

    def decode(
        self, source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]
    ) -> Log:
        """Read the columns that a run needs, and those that the mapping names."""


@dataclass(frozen=True)
class LogFormat:
    """One line of the registry.

    Attributes
    ----------
    name : str
        What people call the format.
    suffixes : tuple of str
        Usual endings of file names, in lower case with the dot.
    module : str
        Module with the functions of `LogModule`, or the object in it that has them, after a colon. It is imported when
        the first file is read.
    extra : str
        Extra of the distribution that brings the libraries it needs; empty where it needs none.
    text : bool
        Whether it is a text, which ends no process that reads it.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    extra: str = ""
    text: bool = False

    @property
    def code(self) -> LogModule:
        """The format's functions, imported."""
        module, _, member = self.module.partition(":")
        found = import_module(module, __package__)
        return cast(LogModule, getattr(found, member) if member else found)

    def missing(self, name: str, error: ImportError) -> RunsError:
        """Return the error for a file of this format where a library is not installed."""
        return RunsError.of_run(
            name,
            f" is a {self.name}; the library {error.name} that reads it is not installed: "
            f"pip install 'joulemap[{self.extra}]'",
            library=error.name,
        )


def mentioned(mapping: Mapping[str, str], topic: str) -> bool:
    """Decide whether a mapping takes something from a topic.

    Result: True where one of its sources has the topic's name, followed by a point.
    """
    return any(f"{topic}." in source for source in mapping.values())


def content_of(source: SourceFile) -> bytes:
    """Return all bytes of a file."""
    if isinstance(source.place, bytes):
        return source.place
    try:
        return source.place.read_bytes()
    except OSError as error:
        raise RunsError.of_run(source.name, str(error)) from error
