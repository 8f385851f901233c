"""Reads the generated inputs within the limits that are promised."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import resource
import signal
import time
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import JoulemapError
from tests.fuzz.inputs import read_one

SECONDS, MEMORY_MB = 10.0, 1_000.0
"""What every file and every input has to be answered within."""


@dataclass
class Read:
    """What came of the inputs of one reader."""

    reader: str
    outcomes: Counter[str]
    seconds: float
    slowest: tuple[float, int]
    failures: list[str]

    def line(self) -> str:
        """The figures in a line."""
        counts = ", ".join(f"{name} {count}" for name, count in self.outcomes.most_common())
        return (
            f"{self.reader}: {sum(self.outcomes.values())} inputs in {self.seconds:.0f} s ({counts}); "
            f"slowest {self.slowest[0]:.2f} s (number {self.slowest[1]}); {len(self.failures)} failures"
        )


def fuzz_reader(reader: str, count: int, seed: int, *, most_failures: int = 20) -> Read:
    """Read generated inputs in a process of limited memory, which is replaced when an input ends it."""
    context = mp.get_context("spawn")
    outcomes: Counter[str] = Counter()
    failures: list[str] = []
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
            failures.append(f"{reader} number {at}: it ended the process with {child.exitcode}")
            outcomes["process ended"] += 1
            at += 1
        child.join()
    return Read(reader, outcomes, time.monotonic() - start, slowest, failures)


def _read_many(reader: str, seed: int, first: int, count: int, out: Any) -> None:
    with np.errstate(all="ignore"):
        _read_within(reader, seed, first, count, out)


def _read_within(reader: str, seed: int, first: int, count: int, out: Any) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(Exception):  # everything is loaded before memory is limited
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
