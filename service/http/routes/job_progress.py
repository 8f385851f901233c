"""How far a job is, as server-sent events."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter
from sse_starlette import EventSourceResponse, ServerSentEvent

from joulemap.service.http.documents import problems
from joulemap.service.http.state import Service, ServiceDep

router = APIRouter()
_DELETED = "deleted"
_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `progress`, at the end `end`; each with `id`, `status` and `progress` of the job",
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
    },
    **problems(404),
}


@router.get("/costmaps/{costmap_id}/events", tags=["cost maps"], response_class=EventSourceResponse, responses=_EVENTS)
async def follow_costmap(costmap_id: str, service: ServiceDep) -> EventSourceResponse:
    """Follow a cost map that is being made, as server-sent events: `progress` at every change, and one `end`.

    The status in `end` is that of the cost map, or `deleted`. A browser's EventSource connects again after the end:
    close it then.
    """
    await run_sync(service.store.costmap, costmap_id)
    return _stream(service, costmap_id)


@router.get(
    "/calibrations/{calibration_id}/events",
    tags=["runs and calibrations"],
    response_class=EventSourceResponse,
    responses=_EVENTS,
)
async def follow_calibration(calibration_id: str, service: ServiceDep) -> EventSourceResponse:
    """Follow a calibration that is being made, as server-sent events, like a cost map."""
    await run_sync(service.store.calibration, calibration_id)
    return _stream(service, calibration_id)


def _stream(service: Service, job_id: str) -> EventSourceResponse:
    return EventSourceResponse(_events(service, job_id))


async def _events(service: Service, job_id: str) -> AsyncIterator[ServerSentEvent]:
    async for state in service.job_events.follow(job_id):
        status, progress = (_DELETED, 0.0) if state is None else state
        data = json.dumps({"id": job_id, "status": status, "progress": progress})
        yield ServerSentEvent(data, event="end" if state is None or state.over else "progress")
