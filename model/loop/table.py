"""The cells of a CSV log by column, as numbers or texts; what is not a table is refused with its row and column."""

from __future__ import annotations

import csv
import io
import math

import numpy as np
from numpy.typing import NDArray

from model.errors import RunsError

FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]

NUMERIC_COLUMNS = frozenset(
    {
        "t", "x", "y", "z", "lat", "lon", "voltage", "current", "speed", "heading", "roll", "pitch", "temperature",
        "wind_speed", "wind_from", "payload", "motor_temperature", "gps_error",
    }
)  # fmt: skip
"""Columns that must hold numbers; any other column is text as soon as one cell is not a number."""

LEAST_ROWS = 5


def count_repair(repairs: dict[str, int], key: str, count: int) -> None:
    """Add to a count of repairs; a key is there only when its count is not zero."""
    if count:
        repairs[key] = repairs.get(key, 0) + int(count)


def read_table(text: str, name: str, repairs: dict[str, int]) -> tuple[dict[str, FloatArray], dict[str, TextArray]]:
    """Columns of numbers (NaN is blank, nan or inf) and of texts. A last line that breaks off is dropped and counted.

    Raises RunsError for anything else that is not a table, or for a known numeric column with a text in it.
    """
    header, widths, cells = _cells(text)
    if not header:
        raise RunsError(f"run {name}: the file is empty", run=name)
    twice = sorted({c for c in header if header.count(c) > 1})
    if twice:
        raise RunsError(f"run {name}: column {twice[0]!r} appears twice", run=name, column=twice[0])
    if widths and widths[-1] < len(header):
        del cells[len(cells) - widths.pop() :]
        count_repair(repairs, "truncated_rows", 1)
    for k, width in enumerate(widths):
        if width != len(header):
            raise RunsError(
                f"run {name}, row {k + 2}: {width} cells where the header has {len(header)} columns",
                run=name, row=k + 2,
            )  # fmt: skip
    if len(widths) < LEAST_ROWS:
        raise RunsError(f"run {name}: {len(widths)} rows are too few, at least {LEAST_ROWS} are needed", run=name)
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    for k, column in enumerate(header):
        entries = cells[k :: len(header)]
        try:
            values = np.array(list(map(float, entries)) if "" not in entries else _with_blanks(entries))
            numbers[column] = np.where(np.isfinite(values), values, np.nan)
        except ValueError:
            if column in NUMERIC_COLUMNS or column.startswith("current_"):
                row = next(k for k, entry in enumerate(entries) if not _is_number(entry))
                raise RunsError(
                    f"run {name}, column {column!r}, row {row + 2}: {entries[row]!r} is not a number",
                    run=name, column=column, row=row + 2, value=entries[row],
                ) from None  # fmt: skip
            texts[column] = np.array(entries)
    return numbers, texts


def _cells(text: str) -> tuple[list[str], list[int], list[str]]:
    """(header, cells per row, all cells of the body in one list); empty lines do not count."""
    if '"' in text:
        rows = [row for row in csv.reader(io.StringIO(text)) if row]
        flat = [cell for row in rows[1:] for cell in row]
        return [c.strip() for c in rows[0]], [len(row) for row in rows[1:]], flat
    lines = [line for line in text.replace("\r", "\n").split("\n") if line]  # a table without quotes needs no parser
    if not lines:
        return [], [], []
    body = lines[1:]
    return [c.strip() for c in lines[0].split(",")], [line.count(",") + 1 for line in body], ",".join(body).split(",")


def _with_blanks(entries: list[str]) -> list[float]:
    return [float(entry) if entry else math.nan for entry in entries]


def _is_number(entry: str) -> bool:
    try:
        float(entry or "nan")
    except ValueError:
        return False
    return True
