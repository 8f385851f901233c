"""What files of points share: lines of numbers, binary records, and the number of points that is allowed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, TooLargeError

HEADER_BYTES = 65_536
"""A header of points is shorter."""


def check_points(many: int, most: int, name: str) -> None:
    """Refuse more points than the limit before memory is taken for them."""
    if many > most:
        raise TooLargeError(f"{name} holds {many:,} points; the limit is {most:,}", points=many, limit=most)


def parsed(
    rows: Sequence[str],
    columns: int,
    before: int,
    name: str,
    *,
    mark: str | None = None,
    used: Sequence[int] | None = None,
) -> NDArray[np.float64]:
    """Return the numbers of lines. The result is (lines, columns), or those that are used.

    `mark`: between cells, spaces by default; `before`: lines before these.
    """
    if columns < 3:
        raise HeightmapError(f"{name}: its lines hold {columns} numbers, and not x, y and a height")
    try:
        return np.loadtxt(rows, delimiter=mark, usecols=used, comments=None, quotechar='"', ndmin=2)
    except ValueError as error:
        for k, line in enumerate(rows):
            cells = line.split(mark)
            try:
                wrong = len(cells) != columns or not [float(cells[j].strip('" \n')) for j in used or range(columns)]
            except ValueError:
                wrong = True
            if wrong:
                raise HeightmapError(
                    f"{name}, line {before + k + 1}: {line.strip()[:60]!r} is no point of {columns} numbers"
                ) from error
        raise HeightmapError(f"{name}: {str(error)[:200]}") from error


def table(text: bytes, many: int, columns: int, name: str) -> NDArray[np.float64]:
    """Return the numbers of the first lines of a text. The result is (many, columns)."""
    rows = text.split(b"\n", many)[:many]
    if len(rows) < many:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {len(rows):,} there")
    return (
        parsed([row.decode("ascii", "replace") for row in rows], columns, 0, name) if many else np.empty((0, columns))
    )


def records(body: memoryview, record: np.dtype, many: int, name: str) -> NDArray[np.float64]:
    """Return x, y and z of binary records. The result is (many, 3)."""
    there = len(body) // record.itemsize
    if not 0 <= many <= there:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {there:,} there")
    points = np.frombuffer(body, record, many)
    return np.column_stack([points[axis].astype(np.float64) for axis in "xyz"])
