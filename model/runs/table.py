"""What the tables of logs share, whatever their format: which columns are numbers, and how large a table may be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import TooLargeError

LONGEST_NAME = 300
"""Most characters of the name of a column."""
FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]

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
        """Refuse a declared size before memory is allocated for it."""
        for what, found, limit, advice in (
            ("columns", columns, self.columns, "leave columns out"),
            ("rows", rows, self.rows, "split it"),
            ("cells", rows * columns, self.cells, "split it, or leave columns out"),
        ):
            if found > limit:
                words = f" has {found:,} {what}, the limit is {limit:,}: {advice}"
                raise TooLargeError.of_run(name, words, **{what: found}, limit=limit)

    def check_texts(self, rows: int, letters: int, name: str, column: str) -> None:
        """Refuse a column of text before memory is allocated for it."""
        size_mb = rows * letters * 4 / 1e6  # NumPy keeps every cell as long as the longest, 4 bytes for a letter
        if size_mb > self.text_mb:
            raise TooLargeError.of_run(
                name,
                f", column {column[:80]!r}: {rows:,} texts of up to {letters:,} letters take {size_mb:,.0f} "
                f"MB, the limit is {self.text_mb:,.0f} MB: shorten them, or leave the column out",
                column=column[:80],
                text_mb=size_mb,
                limit=self.text_mb,
            )


SIDES, TURNING = ("speed_left", "speed_right"), ("wheel_left_rad_s", "wheel_right_rad_s")
"""Columns of how fast the sides roll [m/s], and their wheels turn [rad/s]."""

LIMITS = TableLimits()
"""Of files that somebody reads on a machine of their own."""


def add_count(counts: dict[str, int], key: str, count: int) -> None:
    """Add to a count by key; a key is there only if its count is not zero."""
    if count:
        counts[key] = counts.get(key, 0) + int(count)


def columns_there(numbers: Iterable[str]) -> str:
    """Return the end of a sentence about a missing column."""
    return f"; its other columns of numbers are {(', '.join(sorted(numbers)) or 'none')[:400]}"


def usable(values: FloatArray) -> FloatArray:
    """Return a column (n,) in which what is infinite or too large is unknown, NaN."""
    right = np.abs(values) <= LARGEST
    return values if right.all() else np.where(right, values, np.nan)


def known_values(values: FloatArray) -> FloatArray:
    """Return the values of a column (n,) that are known, in their order: itself where all are."""
    known = np.isfinite(values)
    return values if known.all() else values[known]


def spread(values: FloatArray) -> float:
    """Return the range of the known values of a column (n,); 0 where none is known."""
    known = known_values(values)
    return float(np.ptp(known)) if known.size else 0.0
