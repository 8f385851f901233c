"""What the tables of logs share, whatever their format: which columns are numbers, and how large a table may be."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RunsError, TooLargeError

LONGEST_NAME = 300
"""Most characters of the name of a column."""
FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]

NUMERIC_COLUMNS = frozenset(
    {
        "t",
        "x",
        "y",
        "z",
        "lat",
        "lon",
        "voltage",
        "current",
        "speed",
        "heading",
        "roll",
        "pitch",
        "temperature",
        "wind_speed",
        "wind_from",
        "payload",
        "motor_temperature",
        "gps_error",
    }
)
"""Columns that must hold numbers; any other column is text as soon as one cell is not a number."""

LEAST_ROWS = 5
"""Fewer rows are no run."""

LARGEST = 1e30
"""No quantity of a robot is larger, and the square of this is still a number."""


@dataclass(frozen=True)
class TableLimits:
    """How large a table may be. What a file declares is compared with them before it is read.

    Attributes
    ----------
    rows, columns : int
        Most rows, and most columns.
    cells : int
        Most rows times columns.
    text_mb : float
        Most memory of its columns of text once they are read [1e6 bytes].
    """

    rows: int = 50_000_000
    columns: int = 10_000
    cells: int = 200_000_000
    text_mb: float = 4_000.0

    def check(self, rows: int, columns: int, name: str) -> None:
        """Refuse a declared size before memory is allocated for it.

        Parameters
        ----------
        rows, columns : int
            The declared size.
        name : str
            Of the run, for the message.

        Raises
        ------
        TooLargeError
            If it is larger than the limits.
        """
        if columns > self.columns:
            raise TooLargeError(
                f"run {name} has {columns:,} columns, the limit is {self.columns:,}: leave columns out",
                run=name,
                columns=columns,
                limit=self.columns,
            )
        if rows > self.rows:
            raise TooLargeError(
                f"run {name} has {rows:,} rows, the limit is {self.rows:,}: split it",
                run=name,
                rows=rows,
                limit=self.rows,
            )
        if rows * columns > self.cells:
            raise TooLargeError(
                f"run {name} has {rows * columns:,} cells, the limit is {self.cells:,}: split it, or leave columns out",
                run=name,
                cells=rows * columns,
                limit=self.cells,
            )

    def check_texts(self, rows: int, letters: int, name: str, column: str) -> None:
        """Refuse a column of text before memory is allocated for it.

        Parameters
        ----------
        rows : int
            Number of its cells.
        letters : int
            Length of the longest.
        name, column : str
            Of the run and the column, for the message.

        Raises
        ------
        TooLargeError
            If it would take more memory than the limit.
        """
        size_mb = rows * letters * 4 / 1e6  # NumPy keeps every cell as long as the longest, 4 bytes for a letter
        if size_mb > self.text_mb:
            raise TooLargeError(
                f"run {name}, column {column[:80]!r}: {rows:,} texts of up to {letters:,} letters take {size_mb:,.0f} "
                f"MB, the limit is {self.text_mb:,.0f} MB: shorten them, or leave the column out",
                run=name,
                column=column[:80],
                text_mb=size_mb,
                limit=self.text_mb,
            )


LIMITS = TableLimits()
"""Of files that somebody reads on a machine of their own."""


def add_count(counts: dict[str, int], key: str, count: int) -> None:
    """Add to a count by key; a key is there only if its count is not zero.

    Parameters
    ----------
    counts : dict
        Counts by key, which are added to.
    key : str
        Of a rule, or of a reason.
    count : int
        To add.
    """
    if count:
        counts[key] = counts.get(key, 0) + int(count)


def columns_there(numbers: Iterable[str]) -> str:
    """Return the end of a sentence about a missing column.

    Parameters
    ----------
    numbers : iterable of str
        Names of the columns of numbers that are there.

    Returns
    -------
    str
        That lists them.
    """
    return f"; its other columns of numbers are {(', '.join(sorted(numbers)) or 'none')[:400]}"


def check_names(columns: Sequence[str], name: str) -> None:
    """Refuse a table in which two columns have the same name, or one has a name that is too long.

    Parameters
    ----------
    columns : sequence of str
        Their names.
    name : str
        Of the run, for the message.

    Raises
    ------
    RunsError
        If a name is there twice, or has more than `LONGEST_NAME` characters.
    """
    longest = max(columns, key=len, default="")
    if len(longest) > LONGEST_NAME:
        words = f"run {name}: the column {longest[:40]!r}... has a name of {len(longest):,} characters"
        raise RunsError(f"{words}, the limit is {LONGEST_NAME}", run=name, found=len(longest), limit=LONGEST_NAME)
    twice = sorted(column for column, count in Counter(columns).items() if count > 1)
    if twice:
        raise RunsError(f"run {name}: column {twice[0][:80]!r} appears twice", run=name, column=twice[0][:80])


def must_be_number(column: str) -> bool:
    """Decide whether a column must hold numbers.

    Parameters
    ----------
    column : str
        Its name.

    Returns
    -------
    bool
        Any other column is text as soon as one cell is no number.
    """
    return column in NUMERIC_COLUMNS or column.startswith("current_")


def numbers_of(entries: Sequence[str]) -> FloatArray:
    """Return cells as numbers.

    Parameters
    ----------
    entries : sequence of str
        Texts of cells.

    Returns
    -------
    ndarray of float, (n,)
        NaN where blank.

    Raises
    ------
    ValueError
        If one is no number.
    """
    if "" in entries:
        return np.array([float(entry) if entry else math.nan for entry in entries])
    return np.array(list(map(float, entries)))


def not_a_number(name: str, column: str, entries: Sequence[str], first_row: int) -> RunsError:
    """Return the error of a column that must hold numbers and holds something else.

    Parameters
    ----------
    name, column : str
        Of the run and the column.
    entries : sequence of str
        Cells of which one is no number.
    first_row : int
        Number of the first of them among the rows, from 0.

    Returns
    -------
    RunsError
        With the place of the first such cell.
    """
    row = next(k for k, entry in enumerate(entries) if not _is_number(entry))
    units = first_row + row == 0 and len(entries) > 1 and _is_number(entries[1])  # a second row of the header
    advice = ": if this row holds the units of the columns, remove it" if units else ""
    return _not_usable(name, column, first_row + row, entries[row][:80], f"is not a number{advice}")


def usable(numbers: dict[str, FloatArray], name: str) -> dict[str, FloatArray]:
    """Return columns in which what is infinite or too large is unknown.

    Parameters
    ----------
    numbers : dict of str to ndarray of float, (n,)
        As they were read.
    name : str
        Of the run, for messages.

    Returns
    -------
    dict of str to ndarray of float, (n,)
        NaN for blank, nan, inf and what is too large.

    Raises
    ------
    RunsError
        If a column that must hold numbers holds one that is too large.
    """
    found = {}
    for column, values in numbers.items():
        known = np.isfinite(values)
        too_large = known & (np.abs(values) > LARGEST)
        if too_large.any() and must_be_number(column):
            row = int(np.argmax(too_large))
            value = float(values[row])
            raise _not_usable(name, column, row, value, f"is larger than {LARGEST:g}: leave unknown cells blank")
        found[column] = np.where(known & ~too_large, values, np.nan)
    return found


def _not_usable(name: str, column: str, row: int, value: object, what: str) -> RunsError:
    line = row + 2  # counted from 1, after the header
    return RunsError(
        f"run {name}, column {column!r}, row {line}: {value!r} {what}",
        run=name,
        column=column,
        row=line,
        value=str(value),
    )


def _is_number(entry: str) -> bool:
    try:
        float(entry or "nan")
    except ValueError:
        return False
    return True
