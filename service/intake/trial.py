"""Reads Parquet files on trial in a process of their own: on some that are corrupt, Arrow ends the process.

A command or a notebook reads them in its own process afterwards, and would end with them.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from joulemap.model.errors import JoulemapError, RunsError
from joulemap.model.runs.parquet_table import PARQUET_MAGIC, read_parquet
from joulemap.model.runs.table import TableLimits


def refuse_deadly(files: Sequence[Path]) -> None:
    """Refuse a Parquet file that ends the process that reads it.

    Parameters
    ----------
    files : sequence of Path
        Of any kind; those that are no Parquet files are not looked at.

    Raises
    ------
    RunsError
        If there is one.
    """
    suspects = [str(file.resolve()) for file in files if _is_parquet(file)]
    if not suspects:
        return
    tried = subprocess.run(
        [sys.executable, "-m", __name__, *suspects], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=False
    )
    if tried.returncode < 0:
        number = tried.stdout.count(b"\n")
        raise RunsError(
            f"run {Path(suspects[number]).name}: reading it ends the process "
            f"({signal.Signals(-tried.returncode).name}): the Parquet file is corrupt",
            run=Path(suspects[number]).name,
        )


def _is_parquet(file: Path) -> bool:
    with file.open("rb") as content:
        return content.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC


def _main(files: Sequence[str]) -> None:
    """Print a line for each file that was read or refused."""
    for file in files:
        with suppress(JoulemapError):  # who reads it next says it better
            read_parquet(Path(file).read_bytes(), Path(file).name, TableLimits())
        print(flush=True)


if __name__ == "__main__":
    _main(sys.argv[1:])
