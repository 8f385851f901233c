"""Tables in memory as files of Parquet, so that they are read as any other log."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import named

_NUMBERS = count(1)


def is_table(given: Any) -> bool:
    """Decide whether something is a table.

    Result: True for a data frame of pandas or polars, a table of pyarrow, and a mapping.
    """
    return isinstance(given, Mapping) or (hasattr(given, "columns") and hasattr(given, "__getitem__"))


def kept_table(table: Any) -> Path:
    """Write a table to a folder that is gone when the process ends."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    name = f"table_{next(_NUMBERS)}.parquet"
    try:
        if isinstance(table, Mapping):
            found = pa.table({str(key): pa.array(values, from_pandas=True) for key, values in table.items()})
        elif isinstance(table, pa.Table):
            found = table
        elif hasattr(table, "to_arrow"):  # polars
            found = table.to_arrow()
        else:
            found = pa.Table.from_pandas(table.set_axis(named([str(key) for key in table.columns]), axis=1))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise RunsError(f"run {name}: not a readable table: {str(error)[:200]}", run=name) from error
    place = _folder() / name
    pq.write_table(found, place)
    return place


def is_kept(path: Path) -> bool:
    """Decide whether a file is one of `kept_table`."""
    return path.parent == _folder()


@cache
def _folder() -> Path:
    _kept.append(tempfile.TemporaryDirectory(prefix="joulemap-"))
    return Path(_kept[0].name)


_kept: list[tempfile.TemporaryDirectory[str]] = []
