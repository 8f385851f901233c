"""Many cases, one by one or in processes of their own; finished ones are kept, so that a run can be continued."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def rows_of(
    work: Callable[[str], Row], keys: Sequence[str], *, jobs: int = 1, kept: Path | None = None, say: bool = True
) -> list[Row]:
    """Do the work of every key.

    Parameters
    ----------
    work : callable
        From a key to a JSON-able row; importable, because other processes call it.
    keys : sequence of str
        What to do.
    jobs : int
        Number of processes.
    kept : Path, optional
        File of JSON lines to which finished rows are appended, and whose rows are not done again unless they failed.
    say : bool
        Whether to report progress on standard error.

    Returns
    -------
    list of dict
        In the order of `keys`, with the key as `key` and the seconds as `s`. Of work that raised an error, only
        `error` and these.
    """
    done: dict[str, Row] = {}
    if kept is not None and kept.is_file():
        for line in kept.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            if "error" not in row:
                done[row["key"]] = row
    todo = [key for key in keys if key not in done]
    begun = time.monotonic()

    def _take(row: Row) -> None:
        done[row["key"]] = row
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        if say:
            count = sum(key in done for key in todo)
            rest = (time.monotonic() - begun) / count * (len(todo) - count)
            print(
                f"{count}/{len(todo)} {row['key']}: {row.get('said', row.get('error'))} ({rest / 60:.0f} min left)",
                file=sys.stderr,
                flush=True,
            )

    if jobs <= 1 or len(todo) < 2:
        for key in todo:
            _take(_timed(work, key))
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_one_thread) as pool:
            for future in as_completed([pool.submit(_timed, work, key) for key in todo]):
                _take(future.result())
    return [done[key] for key in keys]


def _timed(work: Callable[[str], Row], key: str) -> Row:
    begun = time.monotonic()
    try:
        row = work(key)
    except Exception as error:  # one case that fails must not end a night of others; the tables count it
        row = {"error": f"{type(error).__name__}: {error}"}
    return row | {"key": key, "s": round(time.monotonic() - begun, 2)}


def _one_thread() -> None:
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)
