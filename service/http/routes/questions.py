"""Questions to a cost map: which way is best, and whether the battery lasts."""

from __future__ import annotations

from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, Request, Response

from joulemap.planner.grid.stopping import check_stop
from joulemap.planner.verdict.budget import battery_along
from joulemap.service.exports.track import track_of_plan, track_of_task, track_of_tour
from joulemap.service.feasibility import assess, judge_routes
from joulemap.service.http.access_at_once import EventStream
from joulemap.service.http.asked import answer_of, same_robot, warnings_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.document_rules import event_schema
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import EVENTS, Report, events, while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.http.route_files import FILES, Coordinates, FileFormat, route_file_wanted
from joulemap.service.objectives import limited, plan_by
from joulemap.service.places import Places
from joulemap.service.questions.feasibility import FeasibilityRequest
from joulemap.service.questions.parts import battery_of
from joulemap.service.questions.path import PathRequest
from joulemap.service.questions.tour import TourRequest
from joulemap.service.schemas.answers import feasibility_values, path_values, verdict_out
from joulemap.service.schemas.planning import FeasibilityOut, PathOut
from joulemap.service.schemas.tours import TourOut, tour_out

_QUICK = 1_000  # points: the verdict is there sooner than a client can hang up

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)


@router.post(
    "/paths",
    response_model=PathOut,
    responses={
        200: {
            "content": {
                **FILES,
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
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Any:
    """The energy-optimal path from start to goal with its energy and profile, and the shortest path for comparison.

    On a large cost map this takes up to a minute. It ends when the connection is closed. With the header `Accept:
    text/event-stream` the answer comes as server-sent events: `progress` with the share that is done, and at the end
    `answer` with the JSON, or `problem`.
    """
    row = await run_sync(service.done_costmap, costmap_id)
    file = route_file_wanted(format, accept, coordinates)

    def _find(report: Report) -> Response:
        robot = same_robot(row, wanted.robot)
        battery = battery_of(wanted.battery, robot)
        with service.maps.for_routes(costmap_id) as planner:
            places = Places(planner.lattice.frame)
            file.check(places.frame)
            planner = limited(planner.avoiding(places.areas(wanted.avoid)), wanted.max_power_w)
            plan = plan_by(
                planner,
                places(wanted.start, "start"),
                places(wanted.goal, "goal"),
                wanted.chosen_by,
                battery=battery if wanted.battery is not None else None,
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
            plan = places.noted(plan)
            verdict = judge_routes(planner.lattice, [plan.route], battery) if wanted.battery is not None else None
            if file.chosen is not None:
                battery_out = None if verdict is None else verdict_out(verdict).model_dump()
                track = track_of_plan(plan, planner.lattice, warnings=warnings_of(row), battery=battery_out)
                return file.response(track, f"{costmap_id}-path")
        return answer_of(path_values(plan, verdict, warnings_of(row)))

    async def _found(report: Report) -> Response:
        return await service.plans.do(costmap_id, lambda: _find(report))

    if EVENTS in (accept or ""):
        return EventStream(events(_found))
    return await while_connected(request, _found(lambda _share: None))


@router.post("/tours", response_model=TourOut, responses={200: {"content": dict(FILES)}, **problems(404, 409, 503)})
async def find_tour(
    costmap_id: str,
    wanted: TourRequest,
    service: KernelsDep,
    request: Request,
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Any:
    """The round trip of least energy that visits all stops and returns to the first one."""
    row = await run_sync(service.done_costmap, costmap_id)
    file = route_file_wanted(format, accept, coordinates)

    def _find() -> Response:
        battery = battery_of(wanted.battery, same_robot(row, wanted.robot))
        planner = service.maps.planner(costmap_id)
        places = Places(planner.lattice.frame)
        file.check(places.frame)
        planner = planner.avoiding(places.areas(wanted.avoid))
        trip = planner.tour(
            [places(stop, f"stop {k}") for k, stop in enumerate(wanted.stops)],
            neighbours=wanted.neighbours,
            refine=wanted.refine,
            time_limit_s=wanted.time_limit_s,
            snap=wanted.snap,
        )
        trip = places.noted(trip)
        if file.chosen is not None:
            return file.response(track_of_tour(trip, planner.lattice, warnings=warnings_of(row)), f"{costmap_id}-tour")
        verdict = judge_routes(planner.lattice, trip.legs, battery) if wanted.battery is not None else None
        return answer_of(tour_out(trip, verdict, warnings_of(row)))

    return await while_connected(request, service.plans.do(costmap_id, _find))


@router.post(
    "/feasibility", response_model=FeasibilityOut, responses={200: {"content": dict(FILES)}, **problems(404, 409, 503)}
)
async def ask_feasibility(
    costmap_id: str,
    wanted: FeasibilityRequest,
    service: KernelsDep,
    request: Request,
    format: FileFormat = None,
    coordinates: Coordinates = None,
    accept: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Any:
    """Whether a battery lasts for a given path, or for the best path from start to goal; also for a round trip.

    A given path is only priced: it does not wait for the plans of others. So a robot may ask again and again with the
    rest of its path. With a `format` the answer is a file of what is driven: the way out, and the way back of a round
    trip.
    """
    given, file = wanted.path, route_file_wanted(format, accept, coordinates)
    queue, lend = (
        (service.plans, service.maps.for_routes) if given is None else (service.prices, service.maps.for_pricing)
    )

    def _judge() -> Response:
        row = service.done_costmap(costmap_id)
        robot = same_robot(row, wanted.robot)
        battery, along = battery_of(wanted.battery, robot), None
        with lend(costmap_id) as planner:
            file.check(planner.lattice.frame)
            planner = planner.avoiding(Places(planner.lattice.frame).areas(wanted.avoid))
            assessment = assess(
                limited(planner, wanted.max_power_w),
                battery=battery,
                path=given,
                start=wanted.start,
                goal=wanted.goal,
                round_trip=wanted.round_trip,
                snap=wanted.snap,
                objective=wanted.chosen_by,
            )
            if file.chosen is not None:
                notes, battery_out = warnings_of(row), verdict_out(assessment.verdict).model_dump()
                track = track_of_task(assessment.routes, planner.lattice, warnings=notes, battery=battery_out)
                return file.response(
                    track, f"{costmap_id}-there-and-back" if wanted.round_trip else f"{costmap_id}-path"
                )
        if wanted.profile:
            along = battery_along(assessment.routes, battery, robot.nominal_voltage_v)
        return answer_of(feasibility_values(assessment, warnings_of(row), along=along))

    work = queue.do(costmap_id, _judge)
    return await (work if given is not None and len(given) <= _QUICK else while_connected(request, work))


def _unless_stopped(report: Report) -> Report:
    """Reports, and ends what nobody waits for any more."""

    def _reported(share: float) -> None:
        check_stop()
        report(share)

    return _reported
