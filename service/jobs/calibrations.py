"""What a calibration job does: it runs `calibrate_on_runs` in another process, which can be stopped at any moment."""

from __future__ import annotations

import json
import multiprocessing
import os
import secrets
import shutil
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.model.errors import JoulemapError
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import read_calibration_runs, read_odometry_runs
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.sites import Site
from joulemap.model.terrain.readers import read_heightmap
from joulemap.service.jobs.steps import Step, Steps
from joulemap.service.loop.calibration import calibrate_on_runs, campaigns_of
from joulemap.service.loop.report_page import report_page
from joulemap.service.loop.rerouting import Task
from joulemap.service.loop.summary import NextStep
from joulemap.service.models import CALIBRATED_FOLDER
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CalibrationRow, named_test_runs

REPORT, PAGE = "report.json", "report.html"
_LOOK_S = 0.5  # between looks whether the job is still wanted


@dataclass(frozen=True)
class _Work:
    """What the process gets. ground : the heightmap's file and name, or how runs without positions are read. request :
    for a cost map with the calibrated model, in words.
    """

    model: str | Path
    ground: tuple[Path, str] | Odometry
    robot: Robot
    files: list[Path]
    base_files: list[Path]
    test_files: list[Path]
    task: Task | None
    campaigns: bool
    quick: bool
    seed: int
    out: Path
    request: str


class Calibrator:
    """Does calibrations.

    Parameters
    ----------
    store : Store
        Open.
    models_dir : Path
        Folder of trained models; a calibrated model is put there under the id of its calibration.
    """

    def __init__(self, store: Store, *, models_dir: Path) -> None:
        self._store = store
        self._models_dir = models_dir

    def do(self, step: Step, steps: Steps, report: Callable[[float], None]) -> None:
        """Do the one step of a calibration and mark it as done; a step that is begun again has the same result.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.
        steps : Steps
            The steps of this worker.
        report : callable
            Is given the share that is done, 0..1, again and again; raises Interrupted where the job is to stop.

        Raises
        ------
        JoulemapError
            As the calibration raised it.
        """
        row = self._store.calibration(step.job_id)
        self.discard(row.id)  # what an earlier try left
        folder = self._store.calibration_folder(row.id)
        out = folder.with_name(f"{row.id}.{secrets.token_hex(4)}.partial")
        asked, model = row.request, row.request["model"]
        work = _Work(
            model=model if model in MODEL_NAMES else self._models_dir / model,
            ground=self._ground(row),
            robot=Robot.from_mapping(asked["robot"]),
            files=self._files(asked["runs"]),
            base_files=self._files(asked["base_runs"]),
            test_files=self._files(named_test_runs(asked)),
            task=None if asked["start"] is None else (tuple(asked["start"][:2]), tuple(asked["goal"][:2])),
            campaigns=asked.get("campaigns", False),  # not in requests of older versions
            quick=asked.get("quick", False),
            seed=asked["seed"],
            out=out,
            request=_costmap_request(row),
        )
        try:
            _in_a_process(work, report)
            self._models_dir.mkdir(parents=True, exist_ok=True)
            shutil.move(out / CALIBRATED_FOLDER, self._models_dir / row.id)
            out.rename(folder)
        finally:
            shutil.rmtree(out, ignore_errors=True)
        document = json.loads((folder / REPORT).read_text(encoding="utf-8"))
        self._store.finish(row.id, {"report": document, "model": row.id})
        if self._store.status(row.id) is None:  # deleted meanwhile
            self.discard(row.id)

    def _ground(self, row: CalibrationRow) -> tuple[Path, str] | Odometry:
        if row.heightmap_id is None:
            return Odometry(**row.request["odometry"])
        return self._store.heightmap_path(row.heightmap_id), self._store.heightmap(row.heightmap_id).name

    def _files(self, sent: Sequence[str]) -> list[Path]:
        return [file for runs in sent for file in self._store.run_files(runs)]

    def rest(self) -> None:
        """Do nothing: nothing is kept between jobs."""

    def discard(self, calibration_id: str) -> None:
        """Delete what was made of a calibration: its report and its model, finished or not.

        Parameters
        ----------
        calibration_id : str
            Its id.
        """
        folder = self._store.calibration_folder(calibration_id)
        for place in (folder, *folder.parent.glob(f"{calibration_id}.*.partial"), self._models_dir / calibration_id):
            shutil.rmtree(place, ignore_errors=True)


def _costmap_request(row: CalibrationRow) -> str:
    """What to send for a cost map with the calibrated model."""
    usual = Robot().as_dict()
    robot = {key: value for key, value in row.request["robot"].items() if value != usual.get(key)}
    body = {"heightmap_id": row.heightmap_id or "HEIGHTMAP", "model": row.id} | ({"robot": robot} if robot else {})
    return f"POST /v1/costmaps {json.dumps(body)}"


def _in_a_process(work: _Work, report: Callable[[float], None]) -> None:
    """Return when the work is done. Raises what the process raised, and what `report` does; then it is killed."""
    context = multiprocessing.get_context("spawn")  # a fork of a process with threads may hang
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(work, there), daemon=True)
    process.start()
    there.close()
    message: Any = 0.0
    with closing(here):
        try:
            while message is not None:
                report(message)
                if here.poll(_LOOK_S):
                    message = here.recv()
                    if isinstance(message, JoulemapError):
                        raise message
        except EOFError:
            process.join()
            raise RuntimeError(f"the calibration's process ended with {process.exitcode}; see its output") from None
        finally:
            process.kill()
            process.join()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _work(work: _Work, there: Connection) -> None:
    """In the process: sends shares of the work that is done, then None, or an error of the tree."""
    for number in (signal.SIGINT, signal.SIGTERM):  # they are meant for the service, which ends this process itself
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        if isinstance(work.ground, Odometry):
            runs = read_odometry_runs(
                work.files, work.ground, work.robot, baseline_files=work.base_files, test_files=work.test_files
            )
        else:
            file, name = work.ground
            files = (tuple(some) for some in (work.base_files, work.test_files))
            site = Site(read_heightmap(file, filename=name), tuple(work.files), work.robot, *files)
            runs = read_calibration_runs([site])
        made = calibrate_on_runs(
            work.model,
            runs,
            out=work.out,
            task=work.task,
            groups=campaigns_of(runs.segments.runs) if work.campaigns else None,
            cross_validate=not work.quick,
            seed=work.seed,
            progress=there.send,
        )
        work.out.mkdir(parents=True, exist_ok=True)
        (work.out / REPORT).write_text(json.dumps(made.document, allow_nan=False) + "\n", encoding="utf-8")
        steps = [NextStep("Make a cost map with the calibrated model", work.request)]
        (work.out / PAGE).write_text(report_page(made, steps=steps), encoding="utf-8")
    except JoulemapError as error:
        there.send(error)
    else:
        there.send(None)
