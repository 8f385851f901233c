"""Writes a log as a CSV file in joulemap's columns and units."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from joulemap.model.runs.names import DISCHARGE
from joulemap.model.runs.table_columns import Table

_FIRST = ("t", "x", "y", "lat", "lon", "z", "voltage", "current", "power")
_ROWS = 20_000  # written at a time


def write_csv(path: str | Path, table: Table) -> None:
    """Write a log as CSV that reads back the same."""
    first = [column for column in _FIRST if column in table.numbers]
    columns: dict[str, np.ndarray] = {column: table.numbers[column] for column in first}
    columns |= {column: values for column, values in table.numbers.items() if column not in columns}
    columns |= table.texts
    rows = len(next(iter(columns.values())))
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(f"{DISCHARGE}_{column}" if column in table.signed else column for column in columns)
        for start in range(0, rows, _ROWS):
            part = [_cells(values[start : start + _ROWS]) for values in columns.values()]
            writer.writerows(zip(*part, strict=True))


def _cells(values: np.ndarray) -> list[object]:
    """Python writes a float with as many digits as it needs; a blank is empty."""
    if values.dtype.kind == "U":
        return list(values.tolist())
    return ["" if value != value else value for value in values.tolist()]
