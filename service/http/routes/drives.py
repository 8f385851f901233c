"""Drives that are followed: samples of the log in, forecasts of the rest out, for one robot or for many."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Response
from sse_starlette import ServerSentEvent

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.http.access_at_once import EventStream
from joulemap.service.http.asked import answer_of
from joulemap.service.http.dependencies import KernelsDep, Limit, Offset, ServiceDep
from joulemap.service.http.document_rules import event_schema
from joulemap.service.http.documents import problems
from joulemap.service.http.service import Service
from joulemap.service.questions.drive import DriveRequest, UpdateRequest
from joulemap.service.schemas.driving import DriveList, DriveOut, drive_out

_DELETED = "deleted"
_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `forecast`, each with the drive, at every update; `deleted` at the end",
        "content": {"text/event-stream": {"schema": event_schema("forecast", _DELETED)}},
    },
    **problems(404),
}
router = APIRouter(tags=["drives"])


@router.post("/costmaps/{costmap_id}/drives", status_code=201, responses=problems(404, 409, 503))
async def begin_drive(costmap_id: str, wanted: DriveRequest, service: KernelsDep) -> DriveOut:
    """Begin to follow a drive along a route: the forecast is that of the plan until samples come.

    A service keeps 1000 drives of each key; the oldest ones make room.
    """

    def _begin() -> DriveOut:
        service.done_costmap(costmap_id)
        service.store.check_room()
        return drive_out(service.drives.begin(service.store, costmap_id, wanted))

    return await service.prices.do(costmap_id, _begin)


@router.post("/drives/{drive_id}/updates", response_model=DriveOut, responses=problems(404, 409, 503))
async def update_drive(drive_id: str, wanted: UpdateRequest, service: KernelsDep) -> Response:
    """Send what the log of a drive says since the last update, at any rate, and get the forecast of the rest.

    Samples may come in any order within five seconds. Once the answer is there they are kept. A request that was not
    answered may be sent again: a sample that is there already changes nothing, and is counted in `unused`, as one that
    is too late. A sample more than an hour after the one before is refused.
    """
    row = await run_sync(service.store.drive, drive_id)

    def _update() -> Response:
        try:
            service.done_costmap(row.costmap_id)
        except NotFoundError:
            raise ConflictError(
                f"the cost map {row.costmap_id} of drive {drive_id} was deleted: begin a drive over another one",
                costmap_id=row.costmap_id,
            ) from None
        return answer_of(drive_out(service.drives.update(service.store, drive_id, wanted)))

    return await service.prices.do(row.costmap_id, _update)


@router.get("/drives", responses=problems())
def list_drives(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> DriveList:
    """All drives, newest first."""
    rows, total = service.store.drives(limit=limit, offset=offset)
    return DriveList(total=total, items=[drive_out(row) for row in rows])


@router.get("/drives/{drive_id}", responses=problems(404))
def get_drive(drive_id: str, service: ServiceDep) -> DriveOut:
    """A drive with its newest forecast."""
    return drive_out(service.store.drive(drive_id))


@router.get("/drives/{drive_id}/events", response_class=EventStream, responses=_EVENTS)
async def watch_drive(drive_id: str, service: ServiceDep) -> EventStream:
    """Watch a drive, as server-sent events: `forecast` now and at every update, `deleted` at the end."""
    await run_sync(service.store.drive, drive_id)
    return EventStream(_events(service, drive_id))


@router.delete("/drives/{drive_id}", status_code=204, responses=problems(404))
def delete_drive(drive_id: str, service: ServiceDep) -> None:
    """Delete a drive."""
    service.store.delete_drive(drive_id)
    service.drives.forget(drive_id)


async def _events(service: Service, drive_id: str) -> AsyncIterator[ServerSentEvent]:
    async for state in service.drive_events.follow(drive_id):
        if state is None:
            yield ServerSentEvent("{}", event=_DELETED)
            return
        row = await run_sync(service.store.drive, drive_id)
        yield ServerSentEvent(drive_out(row).model_dump_json(), event="forecast")
