"""From Arrow's columns to numbers and texts: leniently, because a column that nobody uses refuses no file.

A column whose cells are mostly numbers is one of numbers; its other cells are unknown, and counted where it is used.
Dates and times of day become seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.instants import seconds_of
from joulemap.model.runs.table import LONGEST_NAME, FloatArray, TableLimits, TextArray, usable
from joulemap.model.runs.units import common_unit

DATE, CLOCK = "date and time", "time of day"
"""Units of columns of seconds since 1970, and since midnight."""

_MARKS = ("", "-", "--", "?", "NA", "N/A", "n/a", "na", "NULL", "null", "None", "none", "nan", "NaN", "NAN", "#N/A")
_NUMBER = r"^\s*(?P<number>[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>[a-zA-Zµ°%][^\d]*)?$"
_DEGREES = (
    r"^\s*(?P<minus>[-+])?(?P<d>\d{1,3})(?:\s+|\s*[°d:]\s*)(?P<m>\d{1,2}(?:[.,]\d+)?)"
    r"(?:(?:\s+|\s*['′m:]\s*)(?P<s>\d{1,2}(?:[.,]\d+)?)?)?\s*[\"″']*\s*(?P<side>[NSEWOnsewo])?\s*$"
)
_DECIMAL = r"[+-]?\d{1,3}\.\d{3,}"  # of degrees: fewer places are no position
_PAIR = rf"^\s*(?P<point>POINT)?\s*[\[(]?\s*(?P<a>{_DECIMAL})\s*[ ,;]\s*(?P<b>{_DECIMAL})\s*[\])]?\s*$"
_GROUPED = {
    ",": (r"^[+-]?\d{1,3}(,\d{3})*(\.\d*)?\s*[a-zA-Z%]*$", r",\d{3}[,.]|^[1-9]\d{0,2}$"),
    ".": (r"^[+-]?\d{1,3}(\.\d{3})*(,\d*)?\s*[a-zA-Z%]*$", r"\.\d{3}[.,]"),
}
"""By the mark between thousands, what all cells of a column look like, and what one of them does at least."""
_HALF = 0.5  # most cells


def named(columns: Sequence[str]) -> list[str]:
    """Return names of columns of which no two are alike and none is empty or too long.

    Result: `column 7` for the seventh that has no name, `speed (2)` for the second of that name.
    """
    found: dict[str, None] = {}
    for k, column in enumerate(columns, start=1):
        name = plain = column.strip()[:LONGEST_NAME] or f"column {k}"
        count = 1
        while name in found:
            count = k if count > 9 else count + 1  # no two columns have one number
            name = f"{plain} ({count})"
        found[name] = None
    return list(found)


def stream_of(
    table: Any, name: str, limits: TableLimits, units: dict[str, str] | None = None, *, title: str = ""
) -> Stream:
    """Return the columns of an Arrow table."""
    limits.check(table.num_rows, table.num_columns, name)
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    said, broken = dict(units or {}), {}
    for column, values in zip(table.column_names, _without_thousands(table.columns), strict=True):
        found, unit, unread = _numbers(values)
        if found is not None:
            numbers[column] = usable(found)
            broken[column] = unread
            if unit:
                said[column] = unit
        elif (pair := _pair(values)) is not None:
            numbers |= {f"{column} {axis}": each for axis, each in pair.items()}
        elif (words := _texts(values, limits)) is not None:
            texts[column] = words
    return Stream(title, numbers, texts, None, said, {key: count for key, count in broken.items() if count})


def _numbers(values: Any) -> tuple[FloatArray | None, str, int]:
    """(values or None, unit where the type says one, number of cells that are no numbers)."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = values.type
    if pa.types.is_dictionary(kind):
        return _of_categories(values)
    if pa.types.is_null(kind):
        return np.full(len(values), np.nan), "", 0
    if pa.types.is_timestamp(kind) or pa.types.is_date(kind) or pa.types.is_time(kind):
        second = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
        if pa.types.is_date(kind):
            return _float(pc.cast(values, pa.timestamp("s")).cast(pa.int64())), DATE, 0
        wide = pa.int32() if kind.bit_width == 32 else pa.int64()
        return _float(values.cast(wide)) * second[kind.unit], DATE if pa.types.is_timestamp(kind) else CLOCK, 0
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return _float(values), "", 0
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return None, "", 0
    return _of_words(values)


def _pair(values: Any) -> dict[str, FloatArray] | None:
    """Latitude and longitude in one cell, `48.137154 11.575382`, or the other way round in a POINT."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not (pa.types.is_string(values.type) or pa.types.is_large_string(values.type)):
        return None
    if _share(values.drop_null().slice(0, 1000), _PAIR) <= _HALF:
        return None
    parts = pc.extract_regex(values, _PAIR)
    first, second = (_float(pc.struct_field(parts, key).cast(pa.float64())) for key in ("a", "b"))
    point = bool(pc.any(pc.equal(pc.struct_field(parts, "point"), "POINT")).as_py())
    return {"lon": first, "lat": second} if point else {"lat": first, "lon": second}


def _of_categories(values: Any) -> tuple[FloatArray | None, str, int]:
    """As `_numbers`, of the dictionary: a long text in it may stand in every row."""
    import pyarrow.compute as pc

    whole = values.unify_dictionaries().combine_chunks()
    if not hasattr(whole, "dictionary"):
        return np.empty(0), "", 0
    found, unit, _ = _numbers(whole.dictionary)
    if found is None:
        return None, unit, 0
    at = np.asarray(pc.fill_null(whole.indices, len(found)).to_numpy(zero_copy_only=False), dtype=np.int64)
    spread = np.append(found, np.nan)[at]
    return spread, unit, int(np.sum(~np.isfinite(spread))) - whole.null_count


def _float(values: Any) -> FloatArray:
    import pyarrow as pa
    import pyarrow.compute as pc

    found = pc.cast(values, pa.float64(), safe=False)
    return np.asarray((pc.fill_null(found, float("nan")) if found.null_count else found).to_numpy(), dtype=np.float64)


def _of_words(values: Any) -> tuple[FloatArray | None, str, int]:
    """Numbers, dates, times or degrees that are written as words."""
    import pyarrow as pa
    import pyarrow.compute as pc

    words = pc.utf8_trim_whitespace(pc.replace_substring(values, "\0", ""))
    words = pc.if_else(pc.is_in(words, pa.array(_MARKS, words.type)), None, words)
    known = len(words) - words.null_count
    if known == 0:
        return np.full(len(words), np.nan), "", 0
    sample = words.drop_null().slice(0, 1000)
    if _share(sample, _NUMBER) > _HALF:
        parts = pc.extract_regex(words, _NUMBER)
        said = pc.utf8_trim_whitespace(pc.struct_field(parts, "unit"))
        units = [u for u in pc.unique(said).to_pylist() if u]
        unit, factors = (units[0] if units else "", []) if len(units) <= 1 else common_unit(units)
        if len(units) <= 1 or unit:
            numbers = _float(_plain(pc.struct_field(parts, "number")).cast(pa.float64()))
            if factors:  # `850 W`, `1.2 kW`
                at = pc.fill_null(pc.index_in(said, pa.array(units)), len(units)).to_numpy(zero_copy_only=False)
                numbers = numbers * np.array([*factors, 1.0])[at]
            return numbers, unit, known - int(np.isfinite(numbers).sum())
    try:
        first = sample.to_pylist()[:20]
        if seconds_of(first, lenient=True)[1] > _HALF * len(first):
            raise ValueError
        different = pc.unique(words)
        seconds, wrong = seconds_of(different.to_pylist(), lenient=True)
    except ValueError:
        degrees = None
        if _share(sample, _DEGREES) > 1 - 1e-9:
            degrees = _degrees(pc.extract_regex(words, _DEGREES))
        return degrees, "deg", 0 if degrees is None else known - int(np.isfinite(degrees).sum())
    if wrong > _HALF * len(different):
        return None, "", 0
    at = pc.index_in(words, different).to_numpy(zero_copy_only=False)
    found = seconds[np.nan_to_num(at, nan=0).astype(np.int64)]
    found[np.isnan(np.asarray(at, dtype=np.float64))] = np.nan
    return found, DATE if np.nanmax(found) > 86_400.0 else CLOCK, known - int(np.isfinite(found).sum())


def _without_thousands(columns: Sequence[Any]) -> list[Any]:
    """Columns without the marks between thousands: of 1,234,567 or 1,234.5, of 1.234,5, also of 1,234 below 987."""
    import pyarrow as pa
    import pyarrow.compute as pc

    found = list(columns)
    for mark, (whole, sure) in _GROUPED.items():
        texts = [k for k, each in enumerate(found) if pa.types.is_string(each.type)]
        alike = [k for k in texts if _share(found[k].slice(0, 1000), whole) == 1.0 == _share(found[k], whole)]
        if any(_share(found[k], f"[{mark}]") and _share(found[k], sure) for k in alike):
            for k in alike:
                found[k] = pc.replace_substring(found[k], mark, "")
    return found


def _share(words: Any, pattern: str) -> float:
    import pyarrow.compute as pc

    return float(pc.mean(pc.match_substring_regex(words, pattern).cast("double")).as_py() or 0.0)


def _plain(words: Any) -> Any:
    """Numbers with a point; blank is unknown."""
    import pyarrow.compute as pc

    found = pc.replace_substring(words, ",", ".")
    return pc.if_else(pc.equal(found, ""), None, found)


def _degrees(parts: Any) -> FloatArray | None:
    """Degrees of `36 08.09412`, `-4°06'40.0"` or `36 08.1 N`; None where minutes are none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    def _part(key: str) -> FloatArray:
        return _float(_plain(pc.struct_field(parts, key)).cast(pa.float64()))

    d, m, s = _part("d"), _part("m"), np.nan_to_num(_part("s"))
    if np.nanmax(np.maximum(m, s)) >= 60.0:
        return None
    west = pc.is_in(pc.utf8_upper(pc.struct_field(parts, "side")), pa.array(["S", "W"]))
    minus = pc.or_(pc.equal(pc.struct_field(parts, "minus"), "-"), west)
    sign = np.where(np.asarray(pc.fill_null(minus, False).to_numpy(zero_copy_only=False), dtype=bool), -1.0, 1.0)
    return np.asarray(sign * (d + m / 60.0 + s / 3600.0))


def _texts(values: Any, limits: TableLimits) -> TextArray | None:
    """Texts, "" for null; None where they are no texts, or take more memory than the limit."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = values.type.value_type if pa.types.is_dictionary(values.type) else values.type
    if pa.types.is_boolean(kind):
        values, kind = values.cast(pa.string()), pa.string()
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return None
    encoded = values if pa.types.is_dictionary(values.type) else values.dictionary_encode()
    encoded = encoded.unify_dictionaries().combine_chunks()
    if not hasattr(encoded, "dictionary"):  # without rows
        return np.empty(0, dtype=np.str_)
    longest = pc.max(pc.utf8_length(encoded.dictionary)).as_py() or 0
    if longest * 4 * max(len(encoded), len(encoded.dictionary)) > limits.text_mb * 1e6:
        return None
    words = np.array([*("" if word is None else word for word in encoded.dictionary.to_pylist()), ""], dtype=np.str_)
    at = np.asarray(pc.fill_null(encoded.indices, len(words) - 1).to_numpy(zero_copy_only=False), dtype=np.int64)
    return words[at]
