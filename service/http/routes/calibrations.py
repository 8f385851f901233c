"""Calibrations: create, list, get, delete."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import anyio
from fastapi import APIRouter, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.model.errors import InputError, NotFoundError, TooLargeError
from joulemap.model.robot import Robot
from joulemap.service.exports.track import track_of_drive
from joulemap.service.http.asked import FILES, Coordinates, FileFormat, file_response, route_file_wanted
from joulemap.service.http.dependencies import Limit, Offset, ServiceDep
from joulemap.service.http.documents import problems
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.http.routes.jobs import Prefer, job_answer
from joulemap.service.http.service import Service
from joulemap.service.loop.calibration import campaigns_of, refuse_calibrated
from joulemap.service.places.places import Places
from joulemap.service.questions.calibrating import CalibrationRequest
from joulemap.service.schemas.base import UnreadableOut, robot_values
from joulemap.service.schemas.kept import calibration_out, listed, shown
from joulemap.service.schemas.loop import CalibrationOut, SegmentsOut
from joulemap.service.storage.stats import frame_of_stats
from joulemap.service.storage.tables import CALIBRATION, CalibrationRow, RunsRow
from joulemap.service.work.calibrations import PAGE, SEGMENTS

router = APIRouter(prefix="/calibrations", tags=["runs and calibrations"], route_class=QuickJsonRoute)
PLACE = "/v1/calibrations"
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"  # it loads nothing


class CalibrationList(BaseModel):
    """Calibrations, newest first, without reports."""

    total: int
    items: list[CalibrationOut | UnreadableOut]


@router.post(
    "",
    status_code=202,
    response_model=CalibrationOut,
    responses={
        201: {"model": CalibrationOut, "description": "Done within the time of `Prefer: wait=SECONDS`"},
        **problems(404, 409, 503),
    },
)
async def make_calibration(wanted: CalibrationRequest, service: ServiceDep, prefer: Prefer = None) -> Response:
    """Find what a model lacks on measured runs, and make a calibrated model; in the background."""
    row = await anyio.to_thread.run_sync(_enqueue, service, wanted)
    return await job_answer(service, row.id, PLACE, prefer, load=service.store.calibration, answer=calibration_out)


@router.get("", responses=problems())
def list_calibrations(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> CalibrationList:
    """All calibrations, newest first."""
    rows, total = service.store.page(CalibrationRow, limit=limit, offset=offset)
    return CalibrationList(total=total, items=listed(rows, partial(calibration_out, with_report=False)))


@router.get("/{calibration_id}", responses=problems(404, 409))
def get_calibration(calibration_id: str, service: ServiceDep) -> CalibrationOut:
    """Status and progress; when done, the report and the id of the calibrated model."""
    return shown(service.store.calibration(calibration_id), calibration_out)


@router.get(
    "/{calibration_id}/report.html",
    response_class=HTMLResponse,
    responses={200: {"description": "The report as a page"}, **problems(404, 409)},
)
def get_report(calibration_id: str, service: ServiceDep) -> HTMLResponse:
    """The report with its figures, in one file that loads nothing else."""
    row = service.done_calibration(calibration_id)
    folder = service.store.intact(CalibrationRow, row.id, service.store.path(CalibrationRow, row.id))
    return HTMLResponse((folder / PAGE).read_bytes(), headers={"Content-Security-Policy": _POLICY})


@router.get("/{calibration_id}/segments", response_model=SegmentsOut, responses=problems(404, 409))
def get_segments(calibration_id: str, service: ServiceDep) -> Response:
    """Measured and predicted energy of each segment, before and after, by run; at most 20,000 segments."""
    row = service.done_calibration(calibration_id)
    file = service.store.intact(CalibrationRow, row.id, service.store.path(CalibrationRow, row.id)) / SEGMENTS
    if not file.exists():
        raise NotFoundError(f"{row.id} is of a version that kept no segments: calibrate again", id=row.id)
    return Response(file.read_bytes(), media_type="application/json")


@router.get(
    "/{calibration_id}/next-drive",
    response_model=dict[str, Any],
    responses={200: {"content": dict(FILES)}, **problems(404, 409)},
)
def get_next_drive(
    calibration_id: str, service: ServiceDep, format: FileFormat = None, coordinates: Coordinates = None
) -> Any:
    """What to drive next: the route that best separates confounded effects or narrows a coefficient."""
    row = service.done_calibration(calibration_id)
    file, drive = route_file_wanted(format, None, coordinates), (row.summary or {})["report"]["next_drive"]
    return drive if file is None else file_response(file, track_of_drive(drive), f"{row.id}-next-drive")


@router.delete("/{calibration_id}", status_code=204, responses=problems(404, 409))
def delete_calibration(calibration_id: str, service: ServiceDep) -> None:
    """Delete a calibration and its model, or stop one that is running; refused while cost maps use the model."""
    service.delete_calibration(calibration_id)


def _enqueue(service: Service, wanted: CalibrationRequest) -> CalibrationRow:
    """Check what can be checked without calibrating, and put the calibration into the queue."""
    on = None if wanted.heightmap_id is None else service.store.heightmap(wanted.heightmap_id)
    ground = None if on is None else on.id
    test, baseline = list(dict.fromkeys(wanted.test_runs)), list(dict.fromkeys(wanted.baseline_runs))
    runs = [runs_id for runs_id in dict.fromkeys(wanted.runs) if runs_id not in test]
    if not runs:
        raise InputError("all runs are test runs: there is none to learn from", field="test_runs")
    if both := [runs_id for runs_id in baseline if runs_id in runs]:
        raise InputError(
            f"the runs {both[0]} are runs to learn from and baseline runs: name earlier runs as baseline",
            field="baseline_runs",
        )
    sent = [service.store.runs(runs_id) for runs_id in dict.fromkeys([*runs, *baseline, *test])]
    if wanted.campaigns:
        campaigns_of([run["name"] for runs_id in runs for run in service.store.runs(runs_id).stats])
    settings = service.settings
    for key, limit in (("rows", settings.max_calibration_rows), ("segments", settings.max_calibration_segments)):
        count = sum(run[key] for row in sent for run in row.stats)
        if count > limit:
            raise TooLargeError(
                f"these runs have {count:,} {key}, the limit of a calibration is {limit:,}: send fewer",
                limit=limit,
                **{key: count},
            )
    odometry = _odometry_of(sent, placed=ground is not None)
    asked = wanted.model_dump(include={"model", "start", "goal", "campaigns", "quick", "seed"})
    if on is not None and asked["start"] is not None:
        frame = frame_of_stats(on.stats)
        for name in ("start", "goal"):
            frame.cell_of(*Places(frame)(asked[name], name), name=name)
    robot = Robot.from_mapping(robot_values(wanted.robot))
    if wanted.model not in MODEL_NAMES:  # those need no check, and only the workers load them
        refuse_calibrated(wanted.model, service.find_predictor(wanted.model))
    service.check_room(CALIBRATION)
    asked |= {"runs": runs, "base_runs": baseline, "test_runs": test}
    row = service.store.add_calibration(ground, {"robot": robot.as_dict(), "odometry": odometry, **asked})
    service.jobs.submit()
    return row


def _odometry_of(sent: Sequence[RunsRow], *, placed: bool) -> dict[str, Any] | None:
    """How runs without positions are read. Raises InputError if they differ, or do not go with a heightmap or none."""
    every = [run for row in sent for run in row.stats]
    ways = [(run.get("placed", True) and run.get("odometry") is None, run.get("odometry")) for run in every]
    if any(way != ways[0] for way in ways):
        raise InputError(
            "calibrate runs with positions, runs without positions, and runs of different track widths separately",
            field="runs",
        )
    with_positions, odometry = ways[0]
    if with_positions and not placed:
        raise InputError("name the heightmap that these runs were driven on", field="heightmap_id")
    if placed and not with_positions:
        raise InputError("runs without positions belong to no heightmap: leave heightmap_id out", field="heightmap_id")
    return odometry
