"""Many validation cases, one by one or in processes of their own."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from tests.loop.cases import SITES, Calibrator, Outcome, base_model, try_case


def find_calibrator(spec: str) -> Calibrator:
    """`module:name` of a class or a function without arguments that makes a calibrator."""
    module, _, name = spec.partition(":")
    made: Calibrator = getattr(importlib.import_module(module), name)()
    return made


def outcomes(todo: list[tuple[str, int]], calibrator: str, work: Path, jobs: int) -> Iterator[Outcome]:
    """Run cases one by one, or in processes of their own, once every site that they need has its base model."""
    for site_seed in sorted({seed % SITES for _, seed in todo}):
        base_model(site_seed, work, anew=True)
    if jobs <= 1:
        yield from (try_case(case, seed, find_calibrator(calibrator), work) for case, seed in todo)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_one_thread) as pool:
        yield from pool.map(_try, todo, [calibrator] * len(todo), [work] * len(todo))


def _try(key: tuple[str, int], calibrator: str, work: Path) -> Outcome:
    return try_case(*key, find_calibrator(calibrator), work)


def _one_thread() -> None:
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)
