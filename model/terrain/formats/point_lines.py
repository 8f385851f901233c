"""What files of points share: lines of numbers, binary records, and the number of points that is allowed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, TooLargeError

HEADER_BYTES = 65_536
"""A header of points is shorter."""


def check_points(many: int, most: int, name: str) -> None:
    """Refuse more points than the limit before memory is taken for them."""
    if many > most:
        raise TooLargeError(f"{name} holds {many:,} points; the limit is {most:,}", points=many, limit=most)


def parsed(rows: list[bytes], columns: int, before: int, name: str) -> NDArray[np.float64]:
    """Return the numbers of lines. The result is (lines, columns)."""
    if columns < 3:
        raise HeightmapError(f"{name}: its lines hold {columns} numbers, and not x, y and a height")
    text = b"\n".join(rows)
    codes = np.frombuffer(text, np.uint8)
    starts = np.diff(codes > 32, prepend=False) & (codes > 32)
    words = np.diff(np.cumsum(starts)[np.append(np.flatnonzero(codes == 10), codes.size - 1)], prepend=0)
    if (words == columns).all():
        try:
            return np.fromstring(text, sep=" ").reshape(-1, columns)
        except ValueError:  # the line is named below
            pass
    for k, line in enumerate(rows):
        try:
            ok = len([float(word) for word in line.split()]) == columns
        except ValueError:
            ok = False
        if not ok:
            shown = line[:60].decode("ascii", "replace")
            raise HeightmapError(f"{name}, line {before + k + 1}: {shown!r} is no point of {columns} numbers")
    return np.array([line.split() for line in rows], dtype=np.float64)


def table(text: bytes, many: int, columns: int, name: str) -> NDArray[np.float64]:
    """Return the numbers of the first lines of a text. The result is (many, columns)."""
    rows = text.split(b"\n", many)[:many]
    if len(rows) < many:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {len(rows):,} there")
    return parsed(rows, columns, 0, name) if many else np.empty((0, columns))


def records(body: memoryview, record: np.dtype, many: int, name: str) -> NDArray[np.float64]:
    """Return x, y and z of binary records. The result is (many, 3)."""
    there = len(body) // record.itemsize
    if not 0 <= many <= there:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {there:,} there")
    points = np.frombuffer(body, record, many)
    return np.column_stack([points[axis].astype(np.float64) for axis in "xyz"])
