"""The cells of a log by column, as numbers or texts, from any format; what is no table is refused with its place."""

from __future__ import annotations

from joulemap.model.errors import RunsError
from joulemap.model.runs.csv_table import read_csv
from joulemap.model.runs.parquet_table import PARQUET_MAGIC, read_parquet
from joulemap.model.runs.table import LEAST_ROWS, LIMITS, FloatArray, TableLimits, TextArray, usable


def read_table(
    content: str | bytes, name: str, repairs: dict[str, int], *, limits: TableLimits = LIMITS
) -> tuple[dict[str, FloatArray], dict[str, TextArray]]:
    """Read a table from a text in CSV, or from the bytes of a file in CSV or Parquet.

    Parameters
    ----------
    content : str or bytes
        Of the whole file.
    name : str
        Of the run, for messages.
    repairs : dict
        Counts by rule, which are added to.
    limits : TableLimits, optional
        How large it may be.

    Returns
    -------
    tuple of dict
        Columns of numbers, (n,) of float, NaN for blank, nan, inf and what is too large; and columns of text.

    Raises
    ------
    RunsError
        If it is no table, or a column that must hold numbers holds something else.
    TooLargeError
        If it is larger than the limits.
    """
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    if data.startswith(PARQUET_MAGIC):
        numbers, texts, rows = read_parquet(data, name, limits)
    else:
        numbers, texts, rows = read_csv(data, name, repairs, limits)
    if rows < LEAST_ROWS:
        raise RunsError(f"run {name}: {rows} rows are too few, at least {LEAST_ROWS} are needed", run=name)
    return usable(numbers, name), texts
