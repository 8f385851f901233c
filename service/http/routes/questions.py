"""Questions to a cost map: which way is best, and whether the battery lasts."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sse_starlette import EventSourceResponse

from joulemap.model.errors import ConflictError
from joulemap.model.robot import Robot
from joulemap.planner.stopping import check_stop
from joulemap.service.http.document_rules import event_schema
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import EVENTS, Report, events, while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.http.state import KernelsDep
from joulemap.service.problems import jsonable
from joulemap.service.schemas.answers import battery_of, feasibility_out, path_geojson, path_out
from joulemap.service.schemas.base import robot_values
from joulemap.service.schemas.planning import FeasibilityOut, FeasibilityRequest, PathOut, PathRequest
from joulemap.service.schemas.tours import TourOut, TourRequest, tour_out
from joulemap.service.storage.tables import CostmapRow
from joulemap.service.workflows import assess, judge_routes

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)
GEOJSON = "application/geo+json"


@router.post(
    "/paths",
    response_model=PathOut,
    responses={
        200: {
            "content": {
                GEOJSON: {"schema": {"type": "object", "description": "FeatureCollection of all paths"}},
                EVENTS: {"schema": event_schema("progress", "answer", "problem")},
            }
        },
        **problems(404, 409, 503),
    },
)
async def find_path(
    costmap_id: str,
    wanted: PathRequest,
    service: KernelsDep,
    request: Request,
    format: Annotated[
        Literal["json", "geojson"] | None, Query(description="default: as the Accept header says, else json")
    ] = None,
    accept: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Any:
    """The energy-optimal path from start to goal with its energy and profile, and the shortest path for comparison.

    On a large cost map this takes up to a minute. It ends when the connection is closed. With the header `Accept:
    text/event-stream` the answer comes as server-sent events: `progress` with the share that is done, and at the end
    `answer` with the JSON, or `problem`.
    """
    row = await run_sync(service.done_costmap, costmap_id)

    def _find(report: Report) -> Response:
        robot = _same_robot(row, wanted.robot)
        battery = battery_of(wanted.battery, robot)
        with service.maps.for_routes(costmap_id) as planner:
            plan = planner.plan(
                (wanted.start[0], wanted.start[1]),
                (wanted.goal[0], wanted.goal[1]),
                planner=wanted.planner,
                neighbours=wanted.neighbours,
                refine=wanted.refine,
                time_limit_s=wanted.time_limit_s,
                seed=wanted.seed,
                alternatives=wanted.alternatives,
                snap=wanted.snap,
                bound=wanted.bound,
                progress=_unless_stopped(report),
            )
            verdict = judge_routes(planner.lattice, [plan.route], battery) if wanted.battery is not None else None
        if format == "geojson" or (format is None and GEOJSON in (accept or "")):
            return JSONResponse(path_geojson(plan, verdict, _warnings(row)), media_type=GEOJSON)
        return _answer(path_out(plan, verdict, _warnings(row)))

    async def _found(report: Report) -> Response:
        return await service.plans.do(costmap_id, lambda: _find(report))

    if EVENTS in (accept or ""):
        return EventSourceResponse(events(_found))
    return await while_connected(request, _found(lambda _share: None))


@router.post("/tours", response_model=TourOut, responses=problems(404, 409, 503))
async def find_tour(costmap_id: str, wanted: TourRequest, service: KernelsDep, request: Request) -> Any:
    """The round trip of least energy that visits all stops and returns to the first one."""
    row = await run_sync(service.done_costmap, costmap_id)

    def _find() -> Response:
        battery = battery_of(wanted.battery, _same_robot(row, wanted.robot))
        planner = service.maps.planner(costmap_id)
        trip = planner.tour(
            [(stop[0], stop[1]) for stop in wanted.stops],
            neighbours=wanted.neighbours,
            refine=wanted.refine,
            time_limit_s=wanted.time_limit_s,
            snap=wanted.snap,
        )
        verdict = judge_routes(planner.lattice, trip.legs, battery) if wanted.battery is not None else None
        return _answer(tour_out(trip, verdict, _warnings(row)))

    return await while_connected(request, service.plans.do(costmap_id, _find))


@router.post("/feasibility", response_model=FeasibilityOut, responses=problems(404, 409, 503))
async def ask_feasibility(costmap_id: str, wanted: FeasibilityRequest, service: KernelsDep, request: Request) -> Any:
    """Whether a battery lasts for a given path, or for the best path from start to goal; also for a round trip.

    A given path is only priced: it does not wait for the plans of others. So a robot may ask again and again with the
    rest of its path.
    """
    given = wanted.path
    queue, lend = (
        (service.plans, service.maps.for_routes) if given is None else (service.prices, service.maps.for_pricing)
    )

    def _judge() -> Response:
        path = None if given is None else np.array([point[:2] for point in given], dtype=np.float64)
        row = service.done_costmap(costmap_id)
        robot = _same_robot(row, wanted.robot)
        with lend(costmap_id) as planner:
            assessment = assess(
                planner,
                battery=battery_of(wanted.battery, robot),
                path=path,
                start=wanted.start,
                goal=wanted.goal,
                round_trip=wanted.round_trip,
                snap=wanted.snap,
            )
        return _answer(feasibility_out(assessment, _warnings(row)))

    return await while_connected(request, queue.do(costmap_id, _judge))


def _unless_stopped(report: Report) -> Report:
    """Reports, and ends what nobody waits for any more."""

    def _reported(share: float) -> None:
        check_stop()
        report(share)

    return _reported


def _answer(body: BaseModel) -> Response:
    """The body as it is: it was validated when it was made, and FastAPI need not do it again."""
    return Response(body.model_dump_json(), media_type="application/json")


def _warnings(row: CostmapRow) -> list[str]:
    return list((row.summary or {}).get("provenance", {}).get("warnings", []))


def _same_robot(row: CostmapRow, given: BaseModel | None) -> Robot:
    """The cost map's robot. Raises ConflictError, naming the fields, when a given one is neither this one nor the one
    that was asked for; RobotError.
    """
    robot, values = Robot.from_mapping(row.robot), robot_values(given)
    Robot.from_mapping(values)
    differing = {
        key: (getattr(robot, key), value)
        for key, value in values.items()
        if value not in (getattr(robot, key), row.request["robot"][key])
    }
    if differing:
        words = ", ".join(f"{key} {there}, not {here}" for key, (there, here) in differing.items())
        raise ConflictError(
            f"cost map {row.id} was made for another robot ({words}): make a cost map for this robot",
            fields=sorted(differing),
            costmap_robot=jsonable({key: there for key, (there, _) in differing.items()}),
            given_robot=jsonable({key: here for key, (_, here) in differing.items()}),
        )
    return robot
