"""Questions to a cost map: which way is best, whether the battery lasts, where it lasts to, and the way home."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse

from joulemap.model.errors import InputError
from joulemap.planner.grid.stopping import check_stop
from joulemap.service.exports.routes import RouteFile
from joulemap.service.http.access import EventStream
from joulemap.service.http.asked import (
    FILES,
    Coordinates,
    FileWanted,
    answer_of,
    attachment,
    file_response,
    refuse_other_robot,
    warnings_of,
)
from joulemap.service.http.dependencies import CostmapDep, OnCostmap
from joulemap.service.http.documents import BINARY, event_schema, problems
from joulemap.service.http.long_questions import EVENTS, Report, events, while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.places.coordinates import known_crs
from joulemap.service.questions import charging, feasibility, homeward, matrix, path, reach, speeds, tour
from joulemap.service.questions.parts import OnMap
from joulemap.service.render.pictures import reach_image
from joulemap.service.schemas.planning import FeasibilityOut, PathOut, TourOut

_QUICK = 1_000  # points: the verdict is there sooner than a client can hang up
_ROUTES: Any = {200: {"content": dict(FILES)}, **problems(404, 409, 503)}
_GEOJSON, _TIFF, _PNG = "application/geo+json", "image/tiff", "image/png"
_AREAS: dict[str, Any] = {_GEOJSON: {"schema": {"type": "object"}}, _TIFF: BINARY, _PNG: BINARY}

Lend = Callable[[str], AbstractContextManager[Any]]
router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)


def _answered(
    question: Any,
    on: OnCostmap,
    wanted: OnMap,
    *,
    lend: Lend | None = None,
    file: RouteFile | None = None,
    name: str = "",
    **more: Any,
) -> Response:
    """Answer a question: as JSON, or as the file that is wanted, of what was found for the same question before.

    `lend`: lends a planner; by default that of a map in memory, which several threads may use.
    """
    row = on.service.done_costmap(on.id)
    refuse_other_robot(row, wanted.robot)
    with nullcontext(on.service.maps.planner(on.id)) if lend is None else lend(on.id) as planner:
        if file is not None:
            file.check(planner.lattice.frame.crs)
        plans = bool(name) and getattr(wanted, "path", None) is None
        asked = f"{name} {wanted.model_dump_json()}" if plans else ""
        found = on.service.answers.find(planner, asked) if plans and file is not None else None
        if found is None:
            found = question.ask(planner, wanted, **more)
            if plans:
                on.service.answers.keep(planner, asked, found)
        if file is not None:
            return file_response(file, question.track(found, warnings_of(row)), f"{on.id}-{name}")
    return answer_of(question.answer(found, warnings_of(row)))


@router.post(
    "/paths",
    response_model=PathOut,
    responses={
        200: {"content": {**FILES, EVENTS: {"schema": event_schema("progress", "answer", "problem")}}},
        **problems(404, 409, 503),
    },
)
async def find_path(wanted: path.PathRequest, on: CostmapDep, file: FileWanted) -> Any:
    """The energy-optimal path from start to goal with its energy and profile, and the shortest path for comparison.

    On a large cost map this takes up to a minute. It ends when the connection is closed. With the header `Accept:
    text/event-stream` the answer comes as server-sent events: `progress` with the share that is done, and at the end
    `answer` with the JSON, or `problem`.
    """
    await on.row()

    async def _found(report: Report) -> Response:
        def _report(share: float) -> None:
            check_stop()  # what nobody waits for any more ends
            report(share)

        lend = on.service.maps.for_routes
        how: dict[str, Any] = {"lend": lend, "file": file, "name": "path", "progress": _report}
        return await on.service.plans.do(on.id, lambda: _answered(path, on, wanted, **how))

    if EVENTS in on.request.headers.get("accept", ""):
        return EventStream(events(_found))
    return await while_connected(on.request, _found(lambda _share: None))


@router.post("/tours", response_model=TourOut, responses=_ROUTES)
async def find_tour(wanted: tour.TourRequest, on: CostmapDep, file: FileWanted) -> Any:
    """The tour of least energy that visits all stops, in the best order or as given."""
    await on.row()
    return await on.planned(lambda: _answered(tour, on, wanted, file=file, name="tour"))


@router.post("/matrix", response_model=matrix.MatrixOut, responses=problems(404, 409, 503))
async def find_matrix(wanted: matrix.MatrixRequest, on: CostmapDep) -> Any:
    """Least energies over grid moves between many places, or from each start to the cheapest of some goals.

    One search for each start, or for each goal, whichever are fewer. A place on blocked ground is no error: its ways
    are null, with the reason.
    """
    return await on.planned(lambda: _answered(matrix, on, wanted))


@router.post("/charging", response_model=charging.ChargingOut, responses=problems(404, 409, 503))
async def find_charging(wanted: charging.ChargingRequest, on: CostmapDep) -> Any:
    """The cheapest way from start to goal that never falls below the reserve, charging at the given places.

    One energy field for each place, and a route for each way that may be part of the answer. Where no chain of places
    reaches the goal, `feasible` is false and the text says why.
    """
    return await on.planned(lambda: _answered(charging, on, wanted))


@router.post("/feasibility", response_model=FeasibilityOut, responses=_ROUTES)
async def ask_feasibility(wanted: feasibility.FeasibilityRequest, on: CostmapDep, file: FileWanted) -> Any:
    """Whether a battery lasts for a given path, or for the best path from start to goal; also for a round trip.

    A given path is only priced: it does not wait for the plans of others. So a robot may ask again and again with the
    rest of its path. With a `format` the answer is a file of what is driven: the way out, and the way back of a round
    trip.
    """
    given, maps = wanted.path, on.service.maps
    lend = maps.for_routes if given is None else maps.for_pricing
    name = "there-and-back" if wanted.round_trip else "path"

    def _judge() -> Response:
        return _answered(feasibility, on, wanted, lend=lend, file=file, name=name)

    if given is None:
        return await on.planned(_judge)
    return await (on.service.prices.do(on.id, _judge) if len(given) <= _QUICK else on.priced(_judge))


@router.post("/return", response_model=homeward.ReturnOut, responses=problems(404, 409, 503))
async def find_point_of_no_return(wanted: homeward.ReturnRequest, on: CostmapDep) -> Any:
    """Until where a robot may follow the rest of its path and still come home, or still reach a place to charge.

    Made for a robot that asks every second with its place, the rest of its path and its measured charge. The first
    question about a home takes as long as an energy field; the energies are kept, and the next ones take milliseconds.
    """
    opened = on.service.maps.opened(on.id)
    quick = opened is not None and homeward.is_quick(opened, wanted)
    return await (on.priced if quick else on.planned)(lambda: _answered(homeward, on, wanted))


@router.post("/speeds", response_model=speeds.SpeedsOut, responses=_ROUTES)
async def find_speeds(wanted: speeds.SpeedsRequest, on: CostmapDep, file: FileWanted) -> Any:
    """The cheapest cruising speed of a route, and its energy against its time at every speed that the model knows.

    The route stays as it is for the robot's declared speed. A model that has seen one speed only, or that does not know
    what speed costs, such as `physics`, is refused. With a `format` the answer is the route as a file: missions have
    the cheapest speed, or a speed for each stretch where those were asked for.
    """

    def _find() -> Response:
        row = on.service.done_costmap(on.id)
        how: dict[str, Any] = {
            "ground": on.service.store.open_heightmap(row.heightmap_id, row.request),
            "predictor": on.service.find_predictor(row.request["model"]),
        }
        return _answered(speeds, on, wanted, file=file, name="speeds", **how)

    return await on.planned(_find)


@router.post("/reach", response_model=reach.ReachOut, responses={200: {"content": _AREAS}, **problems(404, 409, 503)})
async def find_reach(
    wanted: reach.ReachRequest,
    on: CostmapDep,
    format: Annotated[
        Literal["json", "geojson", "geotiff", "png"],
        Query(description="geojson: outlines; geotiff: what is left at every cell [J], a band for each charge"),
    ] = "json",
    coordinates: Coordinates = None,
) -> Any:
    """Where a battery lasts to from a start, one way or there and back, for one or more charges.

    The border is where a route that is planned to it needs all of the charge above the reserve. The first question
    from a start takes as long as an energy field and some routes; further charges and confidences are answered at once.
    """
    row = await on.row()
    if coordinates is not None and format != "geojson":
        raise InputError("`coordinates` is for format=geojson: leave it out", coordinates=coordinates)

    def _find() -> Response:
        refuse_other_robot(row, wanted.robot)
        with on.service.maps.for_routes(on.id) as planner:
            if format == "geojson" and coordinates != "map":
                known_crs(planner.lattice.frame.crs)
            found = reach.ask(planner, wanted)
            warnings = warnings_of(row)
            if format == "png":
                return attachment(reach_image(planner.lattice, found), _PNG, f"{on.id}-reach.png")
        if format == "geotiff":
            return attachment(found.geotiff(), _TIFF, f"{on.id}-reach.tif")
        if format == "geojson":
            return JSONResponse(
                reach.reach_geojson(found, warnings, coordinates=coordinates or "wgs84"), media_type=_GEOJSON
            )
        return answer_of(reach.answer(found, warnings))

    return await on.planned(_find)
