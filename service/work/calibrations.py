"""What a calibration does on a worker: in a process of its own."""

from __future__ import annotations

import errno
import json
import secrets
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from joulemap.model.errors import JoulemapError
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns, read_calibration_runs
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.sites import Site
from joulemap.model.runs.without_map import sites_without_map
from joulemap.model.terrain.readers import read_sent
from joulemap.service.loop.measured import segments_document
from joulemap.service.loop.report_page import report_page
from joulemap.service.loop.summary import NextStep, advice
from joulemap.service.models import CALIBRATED_FOLDER
from joulemap.service.problems import problem_of
from joulemap.service.questions.calibrating import CalibrationOptions, ask
from joulemap.service.storage.files import MODEL_SUMS, sums_of
from joulemap.service.work.processes import end_with_parent, run

REPORT, PAGE, SEGMENTS = "report.json", "report.html", "segments.json"
_ORDER, _PROBLEM = "order.json", "problem.json"
_FULL_EXIT = 28  # of the process, when the disk is full


class Refused(Exception):
    """The runs cannot be calibrated."""

    def __init__(self, problem: dict[str, Any]) -> None:
        super().__init__(problem)
        self.problem = problem


def calibrate(order: Mapping[str, Any], topic: str) -> dict[str, Any]:
    """Calibrate, on a worker; what is there already is not made again."""
    from distributed import get_worker

    folder, calibrated, worker = Path(order["folder"]), Path(order["calibrated"]), get_worker()
    out = folder.with_name(f"{folder.name}.{secrets.token_hex(4)}.partial")

    def _tell(line: str) -> None:
        kind, _, share = line.partition(" ")
        if kind == topic:
            worker.log_event(topic, float(share))

    try:
        if not folder.exists():
            out.mkdir(parents=True)
            (out / _ORDER).write_text(json.dumps(order), encoding="utf-8")
            ended = run(["-m", __name__, str(out), topic], tell=_tell)
            if (out / _PROBLEM).exists():
                raise Refused(json.loads((out / _PROBLEM).read_text(encoding="utf-8")))
            if ended == _FULL_EXIT:
                raise OSError(errno.ENOSPC, "No space left on device", str(out))
            if ended != 0:
                raise RuntimeError(f"the calibration's process ended with {ended}; see the worker's output")
            (out / _ORDER).unlink()
            (out / MODEL_SUMS).write_text(json.dumps(sums_of(out / CALIBRATED_FOLDER)), encoding="utf-8")
            shutil.rmtree(calibrated, ignore_errors=True)  # what an earlier try left
            begun = calibrated.with_name(f"{out.name}")
            shutil.move(out / CALIBRATED_FOLDER, begun)  # perhaps to another file system
            begun.rename(calibrated)
            out.rename(folder)
        return {"report": json.loads((folder / REPORT).read_text(encoding="utf-8")), "model": calibrated.name}
    finally:
        shutil.rmtree(out, ignore_errors=True)


def main(out: Path, topic: str) -> None:
    """Calibrate in this process as `order.json` says, and leave the report, the page and the model beside it."""
    order = json.loads((out / _ORDER).read_text(encoding="utf-8"))
    try:
        runs = _read(order, Robot.from_mapping(order["robot"]))
        start, goal = order["task"] or (None, None)
        options = {name: order[name] for name in ("campaigns", "quick", "seed")}
        wanted = CalibrationOptions.model_construct(start=start, goal=goal, **options)
        made = ask(order["model"], runs, wanted, out=out, progress=lambda share: print(topic, share, flush=True))
    except JoulemapError as error:
        (out / _PROBLEM).write_text(json.dumps(problem_of(error, order["id"])), encoding="utf-8")
        sys.exit(1)
    (out / REPORT).write_text(json.dumps(made.document, allow_nan=False) + "\n", encoding="utf-8")
    (out / SEGMENTS).write_text(json.dumps(segments_document(made.found), allow_nan=False), encoding="utf-8")
    steps = [] if advice(made.document) else [NextStep("Make a cost map with the calibrated model", order["next"])]
    (out / PAGE).write_text(report_page(made, steps=steps), encoding="utf-8")


def _read(order: Mapping[str, Any], robot: Robot) -> CalibrationRuns:
    files, base, test = ([Path(file) for file in order[key]] for key in ("runs", "base_runs", "test_runs"))
    if order["heightmap"] is None:
        odometry = None if order["odometry"] is None else Odometry(**order["odometry"])
        sites = sites_without_map(files, robot, baseline_files=base, test_files=test, odometry=odometry)
        return read_calibration_runs(sites)
    ground = read_sent(Path(order["heightmap"]), filename=order["heightmap_name"], **order["noise"])
    return read_calibration_runs([Site(ground, tuple(files), robot, tuple(base), tuple(test))])


if __name__ == "__main__":
    end_with_parent()
    try:
        main(Path(sys.argv[1]), sys.argv[2])
    except OSError as full:
        if full.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        sys.exit(_FULL_EXIT)
