"""Reads the generated inputs within the limits that are promised."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing as mp
import resource
import signal
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import anyio
import numpy as np
from rosbags.serde import cdr, ros1, utils

from joulemap.model.errors import JoulemapError
from joulemap.service.intake import guard
from joulemap.service.intake.limits import ReadLimits, RunLimits, RunReading
from joulemap.service.intake.readers import Readers
from tests.fuzz.inputs import RUNS, input_of, read_one

SECONDS, MEMORY_MB = 10.0, 1_000.0
"""What every file and every input has to be answered within."""

_TABLE = {"rows": 10**6, "columns": 2_000, "cells": 2 * 10**7, "text_mb": 200.0}
_RUN = RunLimits(mb=64.0, km=200.0, table=_TABLE)


@dataclass
class Read:
    """What came of the inputs of one reader."""

    reader: str
    outcomes: Counter[str]
    seconds: float
    slowest: tuple[float, int]
    failures: list[str]
    ended: list[str]

    def line(self) -> str:
        """The figures in a line, and what ended a process."""
        counts = ", ".join(f"{name} {count}" for name, count in self.outcomes.most_common())
        return (
            f"{self.reader}: {sum(self.outcomes.values())} inputs in {self.seconds:.0f} s ({counts}); "
            f"slowest {self.slowest[0]:.2f} s (number {self.slowest[1]}); {len(self.failures)} failures"
            + "".join(f"\n  {words}" for words in self.ended)
        )


def fuzz_reader(reader: str, count: int, seed: int, *, most_failures: int = 20) -> Read:
    """Read generated inputs in a process of limited memory, which is replaced when an input ends it."""
    context = mp.get_context("spawn")
    outcomes: Counter[str] = Counter()
    failures: list[str] = []
    ended: list[str] = []
    slowest = (0.0, 0)
    at, start = 0, time.monotonic()
    while at < count and len(failures) < most_failures:
        here, there = context.Pipe(duplex=False)
        child = context.Process(target=_read_many, args=(reader, seed, at, count, there), daemon=True)
        child.start()
        there.close()
        try:
            while at < count:
                outcome, seconds, words = here.recv()
                outcomes[outcome] += 1
                slowest = max(slowest, (seconds, at))
                if words:
                    failures.append(f"{reader} number {at}: {words}")
                at += 1
        except EOFError:
            child.join()
            outcomes["process ended"] += 1
            began = time.monotonic()
            said = anyio.run(_in_the_service, input_of(reader, seed, at)[0], reader)
            ended.append(f"{reader} number {at} ended the process ({child.exitcode}); a service says: {said}")
            if time.monotonic() - began > 2 * SECONDS:  # of which a new process takes some
                failures.append(ended[-1])
            at += 1
        child.join()
    return Read(reader, outcomes, time.monotonic() - start, slowest, failures, ended)


async def _in_the_service(content: bytes, reader: str) -> str:
    """What a service says of a file that ends the process: Arrow and GDAL abort on some that are corrupt."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        given: dict[str, Any] = {"path": file.name, "name": reader}
        task = "run" if reader in RUNS else "heightmap"
        if task == "run":
            given |= {"limits_of_run": asdict(_RUN), "reading": RunReading().as_dict()}
        else:
            options = {"resolution_m": 0.5, "scale_m": 0.1}
            given |= {"out": f"{file.name}.tif", "max_cells": 10**6, "options": options}
        try:
            with contextlib.closing(Readers(processes=1, queue=1, limits=ReadLimits(5.0, 750.0))) as readers:
                await readers.read(task, **given)
        except JoulemapError as error:
            return error.message
    return "it was read"


def _compile_once() -> None:
    """Have rosbags compile the code of a message type once: it does so for every bag, for two thirds of the time."""
    made = functools.cache(lambda lines: utils.compile_lines(list(lines)))
    cdr.compile_lines = ros1.compile_lines = lambda lines: made(tuple(lines))


def _read_many(reader: str, seed: int, first: int, count: int, out: Any) -> None:
    with np.errstate(all="ignore"):
        _read_within(reader, seed, first, count, out)


def _read_within(reader: str, seed: int, first: int, count: int, out: Any) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for task in ("heightmap", "run"):  # everything is loaded before memory is limited
        guard.prepared(task)
    _compile_once()
    with contextlib.suppress(Exception):
        read_one(reader, seed, first)
    data = int(next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmData" in line).split()[1])
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (1024 * data + int(MEMORY_MB * 1e6), hard))
    for number in range(first, count):
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        start = time.monotonic()
        words = ""
        try:
            read_one(reader, seed, number)
            outcome = "read"
        except JoulemapError as error:
            outcome = error.code
            words = "" if len(error.message) < 2_000 else f"a message of {len(error.message)} letters"
        except MemoryError:
            outcome = "memory"
        except Exception as error:
            outcome = "failure"
            words = f"{error!r}\n{''.join(traceback.format_tb(error.__traceback__)[-3:])}"
        signal.setitimer(signal.ITIMER_REAL, 0)
        out.send((outcome, time.monotonic() - start, words))
