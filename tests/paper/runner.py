"""Run the experiments of all seeds, two at a time, and keep every result, so that an interrupted run can continue."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numba
import torch
from threadpoolctl import threadpool_limits

from joulemap.model.errors import InputError
from tests.paper import networks
from tests.paper.experiments import EXPERIMENTS, field_of
from tests.paper.profiles import FIRST_SEED, STRATEGIES
from tests.paper.setting import Setting

SETTING_FILE = "setting.json"
WORKERS = 2

_USUAL_S = {  # on one core, in the default profile: decides the order and the progress
    "field": 12.0,
    "baselines": 10.0,
    "compact": 45.0,
    "map_floor": 150.0,
    "learning_curve": 150.0,
    "other_heightmap": 70.0,
    "backbone": 600.0,
    "resnet_frozen": 300.0,
    "resnet_scratch": 700.0,
    "resnet_finetuned": 900.0,
}


@dataclass(frozen=True)
class Task:
    """One experiment of one seed.

    Attributes
    ----------
    kind : str
        Of the experiment.
    seed : int
        Of the field.
    needs : tuple of Task
        Tasks that must be done before.
    """

    kind: str
    seed: int
    needs: tuple[Task, ...] = ()

    @property
    def name(self) -> str:
        """Name of the result's file."""
        return f"{self.kind}_{self.seed}"

    @property
    def usual_s(self) -> float:
        """Usual duration [s]."""
        return _USUAL_S[self.kind]


def plan(setting: Setting, *, only: Sequence[str] = ()) -> list[Task]:
    """List all tasks: first those on which others wait, then the long ones.

    `only`: kinds of experiments, all if empty.
    """
    for kind in only:
        if kind not in EXPERIMENTS:
            raise InputError(f"no experiment {kind!r}: known are {', '.join(EXPERIMENTS)}", name=kind)
    profile = setting.profile
    backbone = Task("backbone", 0)
    tasks: dict[Task, None] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + profile.seeds):
        field = Task("field", seed)
        for kind in only or EXPERIMENTS:
            needs: tuple[Task, ...] = (field,)
            if kind.startswith("resnet"):
                if seed >= FIRST_SEED + profile.resnet_seeds:
                    continue
                if setting.weights is None and kind != f"resnet_{STRATEGIES[1]}":
                    needs = (field, backbone)
            tasks |= dict.fromkeys(needs) | {Task(kind, seed, needs): None}
    return sorted(tasks, key=lambda task: (bool(task.needs), -task.usual_s))


def run_all(
    setting: Setting,
    *,
    only: Sequence[str] = (),
    workers: int = WORKERS,
    progress: Callable[[float], None] | None = None,
    said: Callable[[str], None] | None = None,
) -> None:
    """Run the experiments whose results are not there yet. `only`: kinds of experiments, all if empty."""
    _claim(setting)
    tasks = plan(setting, only=only)
    whole = sum(task.usual_s for task in tasks)
    waiting = [task for task in tasks if not result_file(setting, task.name).exists()]
    done = {task for task in tasks if task not in waiting}
    said, progress = said or (lambda _: None), progress or (lambda _: None)
    if done:
        said(f"{len(done)} of {len(tasks)} experiments are there already")

    def _ended(task: Task, seconds: float) -> None:
        done.add(task)
        said(f"{task.kind}, seed {task.seed}: {seconds:.0f} s")
        progress(sum(one.usual_s for one in done) / whole)

    if workers < 2:
        with _one_thread():
            for task in waiting:
                _ended(task, _run_task(setting, task))
        return
    context = get_context("spawn")  # threads of numba and torch do not survive a fork
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_keep_to_one_thread) as pool:
        running: dict[Future[float], Task] = {}
        while waiting or running:
            for task in [t for t in waiting if done.issuperset(t.needs)][: workers - len(running)]:
                waiting.remove(task)
                running[pool.submit(_run_task, setting, task)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                _ended(running.pop(future), future.result())


def result_file(setting: Setting, name: str) -> Path:
    """Return the file of a task's result."""
    return setting.folder / "results" / f"{name}.json"


def read_results(setting: Setting) -> list[dict[str, Any]]:
    """Read all results of a reproduction. Result: each with kind, seed, seconds, and `methods` or facts."""
    files = sorted(result_file(setting, "x").parent.glob("*.json"))
    return [json.loads(file.read_text(encoding="utf-8")) for file in files]


def read_setting(folder: Path) -> dict[str, Any]:
    """Read the setting that a folder's reproduction was run with."""
    try:
        return dict(json.loads((folder / SETTING_FILE).read_text(encoding="utf-8")))
    except OSError as error:
        raise InputError(f"{folder} holds no reproduction: it has no readable {SETTING_FILE}") from error


def _claim(setting: Setting) -> None:
    """Write the setting into the folder; refuse a folder of another one. More seeds do not make another setting."""
    weights = setting.weights.name if setting.weights is not None else ""
    wanted = {
        "profile": setting.profile.as_dict(),
        "heightmap_from": setting.heightmap_from,
        "weights": weights,
        **networks.described(setting.weights),
    }
    file = setting.folder / SETTING_FILE
    if file.exists():
        there = read_setting(setting.folder)
        free = {"seeds", "resnet_seeds"}
        for key, value in {**wanted, **wanted["profile"]}.items():
            kept = {**there, **there["profile"]}.get(key)
            if key not in free | {"profile"} and json.loads(json.dumps(value)) != kept:
                raise InputError(
                    f"{setting.folder} holds a reproduction with {key} = {kept}, not {value}: choose another folder",
                    key=key,
                )
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(wanted, indent=2) + "\n", encoding="utf-8")


def _keep_to_one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    threadpool_limits(1)  # of the linear algebra


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for each worker: threads of several workers would wait for each other."""
    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        with threadpool_limits(1):
            torch.set_num_threads(1)
            numba.set_num_threads(1)
            yield
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])


def _run_task(setting: Setting, task: Task) -> float:
    """Run one task and keep its result; seconds it took."""
    begun = perf_counter()
    found: dict[str, Any]
    if task.kind == "field":
        found = field_of(setting, task.seed)
    elif task.kind == "backbone":
        networks.pretrained_backbone(setting.model("backbone", 0), profile=setting.profile, seed=FIRST_SEED)
        found = {}
    else:
        found = {"methods": EXPERIMENTS[task.kind](setting, task.seed).methods}
    seconds = perf_counter() - begun
    file = result_file(setting, task.name)
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f".{file.name}.partial")
    document = {"kind": task.kind, "seed": task.seed, "seconds": round(seconds, 1), **found}
    partial.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    partial.replace(file)
    return seconds
