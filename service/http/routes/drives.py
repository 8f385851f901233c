"""Drives that are followed: samples of the log in, forecasts of the rest out, for one robot or for many."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Request, Response
from sse_starlette import ServerSentEvent

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.http.access import EventStream
from joulemap.service.http.asked import answer_of
from joulemap.service.http.dependencies import KernelsDep, Limit, Offset, ServiceDep
from joulemap.service.http.documents import event_schema, problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.service import Service
from joulemap.service.http.work_queue import OwnWork, WorkQueue
from joulemap.service.questions.drive import DriveRequest, UpdateRequest
from joulemap.service.schemas.driving import BetterOut, ChargeOut, DriveList, DriveOut, drive_out

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

    def _update() -> Response:
        return answer_of(service.drives.update(service.store, drive_id, wanted))

    return await _over_its_map(service, drive_id, _update, service.prices)


@router.get("/drives/{drive_id}/charge", response_model=ChargeOut, responses=problems(404, 409, 503))
async def charge_of_drive(drive_id: str, service: KernelsDep) -> Response:
    """Return the state of charge along the route: what it was behind the robot, and what is expected ahead of it."""

    def _charge() -> Response:
        with service.drives.as_it_is(service.store, drive_id) as drive:
            state = drive.tracking.state
            values = {
                "at_m": state.at_m,
                "position": None if state.last is None else [state.last.x, state.last.y],
                "reserve": drive.battery.reserve,
                "places": [place._asdict() for place in drive.charge_along()],
            }
        return answer_of(ChargeOut.model_validate(values))

    return await _over_its_map(service, drive_id, _charge, service.prices)


@router.get("/drives/{drive_id}/better-route", response_model=BetterOut, responses=problems(404, 409, 413, 503))
async def better_route_of_drive(drive_id: str, request: Request, service: KernelsDep) -> Response:
    """Look for another way to the goal that has become cheaper by more than its uncertainty.

    It is a search over the cost map at what driving costs in this run, so ask for it where an alarm or the verdict
    gives a reason.
    """

    def _look() -> Response:
        found = service.drives.better(service.store, drive_id)
        return answer_of(BetterOut.model_validate({"route": None if found is None else found.as_dict()}))

    return await while_connected(request, _over_its_map(service, drive_id, _look, service.plans))


@router.get("/drives", responses=problems())
def list_drives(
    service: ServiceDep,
    limit: Limit = 100,
    offset: Offset = 0,
    costmap_id: Annotated[str | None, Query(max_length=100, description="only those over this cost map")] = None,
) -> DriveList:
    """All drives, newest first."""
    rows, total = service.store.drives(limit=limit, offset=offset, costmap_id=costmap_id)
    return DriveList(total=total, items=[drive_out(row) for row in rows])


@router.get("/drives/{drive_id}", responses=problems(404))
def get_drive(drive_id: str, service: ServiceDep) -> DriveOut:
    """A drive with its newest forecast."""
    return drive_out(service.store.drive(drive_id))


@router.get("/drives/{drive_id}/events", response_class=EventStream, responses=_EVENTS)
async def watch_drive(drive_id: str, service: ServiceDep) -> EventStream:
    """Watch a drive, as server-sent events: `forecast` now and at every update, `deleted` at the end."""
    await run_sync(partial(service.store.drive, drive_id, whole=False))
    return EventStream(_events(service, drive_id))


@router.delete("/drives/{drive_id}", status_code=204, responses=problems(404))
def delete_drive(drive_id: str, service: ServiceDep) -> None:
    """Delete a drive."""
    service.store.delete_drive(drive_id)
    service.drives.forget(drive_id)


async def _over_its_map(
    service: Service, drive_id: str, work: Callable[[], Response], queue: WorkQueue | OwnWork
) -> Response:
    """Do in a queue what needs the cost map of a drive. Raises ConflictError if that was deleted."""
    row = service.drives.known_row(service.store, drive_id)
    if row is None:
        row = await run_sync(partial(service.store.drive, drive_id, whole=False))
    costmap_id = row.costmap_id

    def _work() -> Response:
        try:
            service.done_costmap(costmap_id)
        except NotFoundError:
            raise ConflictError(
                f"the cost map {costmap_id} of drive {drive_id} was deleted, and the energies along its route with it: "
                f"its last forecast is at /v1/drives/{drive_id}; begin a drive over another cost map",
                costmap_id=costmap_id,
            ) from None
        return work()

    return await queue.do(costmap_id, _work)


async def _events(service: Service, drive_id: str) -> AsyncIterator[ServerSentEvent]:
    async for state in service.drive_events.follow(drive_id):
        if state is None:
            yield ServerSentEvent("{}", event=_DELETED)
            return
        row = await run_sync(service.store.drive, drive_id)
        yield ServerSentEvent(drive_out(row).model_dump_json(), event="forecast")
