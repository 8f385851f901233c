"""Jobs, which are cost maps and calibrations: the answer to a request for one, how far it is, and its cancelling."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any

import anyio
from anyio.to_thread import run_sync
from fastapi import APIRouter, Header
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sse_starlette import ServerSentEvent

from joulemap.service.http import problem_answers
from joulemap.service.http.access import EventStream
from joulemap.service.http.dependencies import ServiceDep
from joulemap.service.http.documents import event_schema, problems
from joulemap.service.http.service import Service
from joulemap.service.schemas.kept import calibration_out, costmap_out
from joulemap.service.schemas.loop import CalibrationOut
from joulemap.service.schemas.maps import CostmapOut
from joulemap.service.storage.tables import DONE, FAILED

MAX_WAIT_S = 300.0
_WAIT = re.compile(r"(?:^|[,;])\s*wait\s*=\s*\"?(\d{1,18})\"?\s*(?:$|[,;])", re.IGNORECASE)

Prefer = Annotated[str | None, Header(description="`wait=SECONDS` (at most 300): answer once it is done")]


async def job_answer(
    service: Service,
    job_id: str,
    place: str,
    prefer: str | None,
    *,
    load: Callable[[str], Any],
    answer: Callable[[Any], BaseModel],
) -> JSONResponse:
    """Answer 202 with the job; if it ends while the caller waits, 201 with the result or the problem of its failure."""
    headers = {"Location": f"{place}/{job_id}"}
    match = _WAIT.search(prefer or "")
    if match:
        seconds = min(float(match.group(1)), MAX_WAIT_S)
        headers["Preference-Applied"] = f"wait={seconds:.0f}"
        await service.job_events.until_over(job_id, seconds)
    row = await anyio.to_thread.run_sync(load, job_id)
    if row.status == FAILED and row.problem is not None:
        body = {**row.problem, "context": {**row.problem["context"], "job_id": job_id}}
        return problem_answers.response(body, headers)
    found = answer(row).model_dump(mode="json")
    return JSONResponse(found, status_code=201 if row.status == DONE else 202, headers=headers)


COSTMAP, CALIBRATION = "/costmaps/{costmap_id}", "/calibrations/{calibration_id}"
router = APIRouter()
_MAPS: list[Any] = ["cost maps"]
_LOOP: list[Any] = ["runs and calibrations"]
_DELETED = "deleted"
_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `progress`, at the end `end`; each with `id`, `status` and `progress` of the job",
        "content": {"text/event-stream": {"schema": event_schema("progress", "end")}},
    },
    **problems(404),
}


@router.get(f"{COSTMAP}/events", tags=_MAPS, response_class=EventStream, responses=_EVENTS)
async def follow_costmap(costmap_id: str, service: ServiceDep) -> EventStream:
    """Follow a cost map that is being made, as server-sent events: `progress` at every change, and one `end`.

    The status in `end` is that of the cost map, or `deleted`. A browser's EventSource connects again after the end:
    close it then.
    """
    await run_sync(service.store.costmap, costmap_id)
    return EventStream(_events(service, costmap_id))


@router.get(f"{CALIBRATION}/events", tags=_LOOP, response_class=EventStream, responses=_EVENTS)
async def follow_calibration(calibration_id: str, service: ServiceDep) -> EventStream:
    """Follow a calibration that is being made, as server-sent events, like a cost map."""
    await run_sync(service.store.calibration, calibration_id)
    return EventStream(_events(service, calibration_id))


@router.post(f"{COSTMAP}/cancel", tags=_MAPS, responses=problems(404, 409))
def cancel_costmap(costmap_id: str, service: ServiceDep) -> CostmapOut:
    """Stop making a cost map. Its record stays, with the status `cancelled`; to remove it too, delete it."""
    service.store.costmap(costmap_id)
    service.cancel(costmap_id)
    return costmap_out(service.store.costmap(costmap_id))


@router.post(f"{CALIBRATION}/cancel", tags=_LOOP, responses=problems(404, 409))
def cancel_calibration(calibration_id: str, service: ServiceDep) -> CalibrationOut:
    """Stop a calibration. Its record stays, with the status `cancelled`; to remove it too, delete it."""
    service.store.calibration(calibration_id)
    service.cancel(calibration_id)
    return calibration_out(service.store.calibration(calibration_id))


async def _events(service: Service, job_id: str) -> AsyncIterator[ServerSentEvent]:
    async for state in service.job_events.follow(job_id):
        status, progress = (_DELETED, 0.0) if state is None else state
        data = json.dumps({"id": job_id, "status": status, "progress": progress})
        yield ServerSentEvent(data, event="end" if state is None or state.over else "progress")
