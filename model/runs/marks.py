"""Marks of unknown values: the largest numbers of a type, which loggers write where nothing was measured."""

from __future__ import annotations

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs.table import FloatArray, add_count, known_values

_WHOLE = [
    *(float(2**bits - less) for bits in (16, 24, 32, 64) for less in (1, 2)),
    *(sign * float(2**bits - less) for bits in (15, 31, 63) for less in (1, 0) for sign in (1, -1)),
    *(sign * float(10**digits - less) for digits in (4, 5, 6) for less in (1,) for sign in (1, -1)),
    1e9, 1e10, 1e20, 1e30, 3.4028235e38,
]  # fmt: skip
MARKS = np.unique([value * 10.0**-places for value in _WHOLE for places in (0, 1, 2, 3)] + [-999.0])
"""Of whole numbers of 16 to 64 bits, also with up to three decimal places; of numbers filled with nines; of floats."""
_SHORT = np.array([255.0, 254.0, 127.0, -128.0, -1.0])
"""Of 8 bits. They are readings too, so they count only beside whole numbers that are all far from them."""
_NO_SIGN = ("speed", "distance", "energy", "charge", "soc", "gps_error")
_APART = 0.5  # of the mark: other values are no larger than this share of it


def without_marks(values: FloatArray, target: str, column: str, name: str, repairs: dict[str, int]) -> FloatArray:
    """Return values of which those that are marks are unknown.

    `values` is (n,). Result (n,): NaN where there is no reading.

    A value is a mark if it is one of `MARKS` and all readings are less than half as large: a reading that happens to be
    such a number has others beside it.
    """
    if target in ("t", "x", "y"):
        return values
    known = known_values(values)
    if not known.size:
        return values
    unknown = np.zeros(values.size, dtype=bool)
    while known.size and (found := _mark(known, target)) is not None:
        unknown |= values == found
        known = known[known != found]
    if not unknown.any():
        return values
    if not known.size:
        mark = float(values[unknown][0])
        raise RunsError.of_run(
            name,
            f", column {column[:80]!r}: {target} is {mark:g} in every row, the mark of an unknown value: it "
            "was not recorded",
            column=column[:80],
            value=mark,
        )
    add_count(repairs, f"marks_{target}", int(unknown.sum()))
    return np.where(unknown, np.nan, values)


def _mark(known: FloatArray, target: str) -> float | None:
    """The largest value, or -1, if it is a mark beside these values."""
    low, high = float(known.min()), float(known.max())
    if target in _NO_SIGN and low == -1.0 and high > 0:
        return low
    value = high if high >= -low else low
    near = bool(np.min(np.abs(MARKS - value)) <= 1e-7 * abs(value))
    short = value in _SHORT and value != -1.0
    if not (near or short):
        return None
    rest = known[known != value]
    if rest.size and float(np.abs(rest).max()) > _APART * abs(value):
        return None
    if short and (not rest.size or known.size - rest.size < 3 or (known != np.round(known)).any()):
        return None
    return value
