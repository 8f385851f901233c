"""Seconds to read a log in CSV as joulemap's columns, beside pyarrow's own reader on the same file.

python -m tests.bench.reading --rows 10000000
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from joulemap.model.runs.logs import read_log
from tests.bench.timing import raced


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    k = np.arange(options.rows)
    columns = {"t": 0.1 * k, "x": 0.05 * k, "y": 4e6 + 0.01 * (k % 1000), "voltage": 24.0 - 1e-3 * (k % 500)}
    columns |= {"current": 3.0 + 0.01 * (k % 77), "temperature": 20.0 + 0.1 * (k % 90)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        csv.write_csv(pa.table({key: np.round(values, 3) for key, values in columns.items()}), file)
        works = {"pyarrow.csv.read_csv": lambda: csv.read_csv(file), "joulemap": lambda: read_log(file, file.name, {})}
        for name, (least, ratio) in raced(works, rounds=options.rounds).items():
            print(f"{name}: {options.rows:,} rows of {len(columns)} columns in {least:.2f} s, {ratio:.2f} times")


if __name__ == "__main__":
    main()
