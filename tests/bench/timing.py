"""How the bench takes times: the least of several repeats, or rivals by turns, so that a busy machine slows all."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

Row = tuple[str, str, float, str, float | None]
"""Cells, stage, seconds (NaN: only words), what it is set beside, ratio ours / theirs."""


def seconds(work: Callable[[], object], *, repeats: int = 3) -> float:
    """Least wall time of `repeats` calls, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def raced(works: dict[str, Callable[[], object]], *, rounds: int = 5) -> dict[str, tuple[float, float]]:
    """(least seconds, median ratio to the first of them) of each, taken by turns: a busy machine slows all alike."""
    for work in works.values():
        work()
    times = np.array([[once(work) for work in works.values()] for _ in range(rounds)])
    ratios = np.median(times / times[:, :1], axis=0)
    return dict(zip(works, zip(times.min(axis=0).tolist(), ratios.tolist(), strict=True), strict=True))


def once(work: Callable[[], object]) -> float:
    """Wall time [s] of one call."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began
