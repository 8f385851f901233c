"""The values of a column, in joulemap's unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.marks import without_marks
from joulemap.model.runs.table import FloatArray
from joulemap.model.runs.units import PER_ROW, conversion


def read_column(
    target: str, source: Source, stream: Stream, name: str, repairs: dict[str, int]
) -> tuple[FloatArray, str]:
    """The values in joulemap's unit, and the unit where it was found out."""
    logged = [without_marks(numbers_of(stream, each, name), target, each, name, repairs) for each in source.columns]
    total = _signed_sum(source, logged)
    unit = (
        "" if source.unit or target not in ("lat", "lon") else agreement.degrees_unit(target, total, source.columns[0])
    )
    if unit == "ddmm":
        return agreement.of_minutes(total), unit
    if source.unit.endswith(PER_ROW):
        total = np.nancumsum(total)
    factor, offset = conversion(target, source.unit or unit) if source.unit or unit else (1.0, 0.0)
    return (total if (factor, offset) == (1.0, 0.0) else factor * total + offset), unit


def stamps_of(source: Source, stream: Stream, name: str) -> FloatArray:
    """Return the time as it is written, in its own unit. Result (n,): NaN where blank."""
    return _signed_sum(source, [numbers_of(stream, column, name) for column in source.columns])


def _signed_sum(source: Source, columns: Sequence[FloatArray]) -> FloatArray:
    terms = [each if sign > 0 else -each for (sign, _), each in zip(source.parts, columns, strict=True)]
    return terms[0] if len(terms) == 1 else np.sum(terms, axis=0)


def numbers_of(stream: Stream, column: str, name: str) -> FloatArray:
    """Return a column of numbers. Result (n,): NaN where blank."""
    if column in stream.numbers:
        return stream.numbers[column]
    cells = stream.texts[column]
    row = next((k for k, cell in enumerate(cells.tolist()) if cell.strip()), 0)
    raise RunsError.of_run(
        name,
        f", column {column[:80]!r}, row {row + 2}: {str(cells[row])[:80]!r} is not a number, and most of its "
        "cells are none",
        column=column[:80],
        row=row + 2,
    )


def words_of(target: str, source: Source, unit: str) -> str:
    """Say where a column was taken from, with the unit that was found out."""
    return Source(source.parts, unit or source.unit).words(target)
