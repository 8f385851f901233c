"""Questions to a cost map: which way is best, whether the battery lasts, and how far it is from home."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, Request, Response

from joulemap.planner.grid.stopping import check_stop
from joulemap.service.http.access_at_once import EventStream
from joulemap.service.http.asked import answer_of, same_robot, warnings_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.document_rules import event_schema
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import EVENTS, Report, events, while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.http.route_files import FILES, Coordinates, FileFormat, WantedFile, route_file_wanted
from joulemap.service.http.service import Service
from joulemap.service.questions import feasibility, homeward, matrix, path, speeds, tour
from joulemap.service.questions.feasibility import FeasibilityRequest
from joulemap.service.questions.homeward import ReturnRequest
from joulemap.service.questions.matrix import MatrixOut, MatrixRequest
from joulemap.service.questions.parts import OnMap
from joulemap.service.questions.path import PathRequest
from joulemap.service.questions.speeds import SpeedsRequest
from joulemap.service.questions.tour import TourRequest
from joulemap.service.schemas.homeward import ReturnOut
from joulemap.service.schemas.planning import FeasibilityOut, PathOut
from joulemap.service.schemas.speeds import SpeedsOut
from joulemap.service.schemas.tours import TourOut

_QUICK = 1_000  # points: the verdict is there sooner than a client can hang up
_FILES: Any = {200: {"content": dict(FILES)}, **problems(404, 409, 503)}

Lend = Callable[[str], AbstractContextManager[Any]]
Accept = Annotated[str | None, Header(include_in_schema=False)]
router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)


def _answered(
    question: Any,
    service: Service,
    costmap_id: str,
    wanted: OnMap,
    lend: Lend,
    *,
    file: WantedFile | None = None,
    name: str = "",
    **more: Any,
) -> Response:
    """Answer a question: as JSON, or as the file that is wanted."""
    row = service.done_costmap(costmap_id)
    same_robot(row, wanted.robot)
    with lend(costmap_id) as planner:
        if file is not None:
            file.check(planner.lattice.frame)
        found = question.ask(planner, wanted, **more)
        if file is not None and file.chosen is not None:
            return file.response(question.track(found, warnings_of(row)), f"{costmap_id}-{name}")
    return answer_of(question.answer(found, warnings_of(row)))


def _whole(service: Service) -> Lend:
    """Lends the planner of a map in memory, which several threads may use."""
    return lambda costmap_id: nullcontext(service.maps.planner(costmap_id))


@router.post(
    "/paths",
    response_model=PathOut,
    responses={
        200: {"content": {**FILES, EVENTS: {"schema": event_schema("progress", "answer", "problem")}}},
        **problems(404, 409, 503),
    },
)
async def find_path(
    costmap_id: str,
    wanted: PathRequest,
    service: KernelsDep,
    request: Request,
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Accept = None,
) -> Any:
    """The energy-optimal path from start to goal with its energy and profile, and the shortest path for comparison.

    On a large cost map this takes up to a minute. It ends when the connection is closed. With the header `Accept:
    text/event-stream` the answer comes as server-sent events: `progress` with the share that is done, and at the end
    `answer` with the JSON, or `problem`.
    """
    await run_sync(service.done_costmap, costmap_id)
    file = route_file_wanted(format, accept, coordinates)

    async def _found(report: Report) -> Response:
        def _find() -> Response:
            how: dict[str, Any] = {"file": file, "name": "path", "progress": _unless_stopped(report)}
            return _answered(path, service, costmap_id, wanted, service.maps.for_routes, **how)

        return await service.plans.do(costmap_id, _find)

    if EVENTS in (accept or ""):
        return EventStream(events(_found))
    return await while_connected(request, _found(lambda _share: None))


@router.post("/tours", response_model=TourOut, responses=_FILES)
async def find_tour(
    costmap_id: str,
    wanted: TourRequest,
    service: KernelsDep,
    request: Request,
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Accept = None,
) -> Any:
    """The round trip of least energy that visits all stops and returns to the first one."""
    await run_sync(service.done_costmap, costmap_id)
    file = route_file_wanted(format, accept, coordinates)

    def _find() -> Response:
        return _answered(tour, service, costmap_id, wanted, _whole(service), file=file, name="tour")

    return await while_connected(request, service.plans.do(costmap_id, _find))


@router.post("/matrix", response_model=MatrixOut, responses=problems(404, 409, 503))
async def find_matrix(costmap_id: str, wanted: MatrixRequest, service: KernelsDep, request: Request) -> Any:
    """Least energies over grid moves between many places, or from each start to the cheapest of some goals.

    One search for each start, or for each goal, whichever are fewer. A place on blocked ground is no error: its ways
    are null, with the reason.
    """

    def _find() -> Response:
        return _answered(matrix, service, costmap_id, wanted, _whole(service))

    return await while_connected(request, service.plans.do(costmap_id, _find))


@router.post("/feasibility", response_model=FeasibilityOut, responses=_FILES)
async def ask_feasibility(
    costmap_id: str,
    wanted: FeasibilityRequest,
    service: KernelsDep,
    request: Request,
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Accept = None,
) -> Any:
    """Whether a battery lasts for a given path, or for the best path from start to goal; also for a round trip.

    A given path is only priced: it does not wait for the plans of others. So a robot may ask again and again with the
    rest of its path. With a `format` the answer is a file of what is driven: the way out, and the way back of a round
    trip.
    """
    given, file = wanted.path, route_file_wanted(format, accept, coordinates)
    name = "there-and-back" if wanted.round_trip else "path"
    lend = service.maps.for_routes if given is None else service.maps.for_pricing

    def _judge() -> Response:
        return _answered(feasibility, service, costmap_id, wanted, lend, file=file, name=name)

    work = (service.plans if given is None else service.prices).do(costmap_id, _judge)
    return await (work if given is not None and len(given) <= _QUICK else while_connected(request, work))


@router.post("/return", response_model=ReturnOut, responses=problems(404, 409, 503))
async def find_point_of_no_return(costmap_id: str, wanted: ReturnRequest, service: KernelsDep, request: Request) -> Any:
    """Until where a robot may follow the rest of its path and still come home, or still reach a place to charge.

    Made for a robot that asks every second with its place, the rest of its path and its measured charge. The first
    question about a home takes as long as an energy field; the energies are kept, and the next ones take milliseconds.
    """
    opened = service.maps.opened(costmap_id)
    quick = opened is not None and homeward.is_quick(opened, wanted)

    def _find() -> Response:
        return _answered(homeward, service, costmap_id, wanted, _whole(service))

    return await while_connected(request, (service.prices if quick else service.plans).do(costmap_id, _find))


@router.post("/speeds", response_model=SpeedsOut, responses=problems(404, 409, 503))
async def find_speeds(costmap_id: str, wanted: SpeedsRequest, service: KernelsDep, request: Request) -> Any:
    """The cheapest cruising speed of a route, and its energy against its time at every speed that the model knows.

    The route stays as it is for the robot's declared speed. A model that has seen one speed only, or that does not know
    what speed costs, such as `physics`, is refused.
    """

    def _find() -> Response:
        row = service.done_costmap(costmap_id)
        how: dict[str, Any] = {
            "ground": service.store.open_heightmap(row.heightmap_id, row.request),
            "predictor": service.find_predictor(row.request["model"]),
        }
        return _answered(speeds, service, costmap_id, wanted, _whole(service), **how)

    return await while_connected(request, service.plans.do(costmap_id, _find))


def _unless_stopped(report: Report) -> Report:
    """Reports, and ends what nobody waits for any more."""

    def _reported(share: float) -> None:
        check_stop()
        report(share)

    return _reported
