"""Which way from one place to another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field

from joulemap.model.ranges import COORDINATE_M, HEADING_DEG, SEARCH_S
from joulemap.planner.planners import PLANNERS
from joulemap.service.questions.parts import BatteryIn, WeighedRequest, battery_of, on_map
from joulemap.service.schemas.base import Place, Request, WholeMap, within

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.planner.answers import Plan
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.planner.verdict.budget import Verdict
    from joulemap.service.exports.track import Track


class SearchOptions(Request):
    """How to search: the fields of `RouteOptions` by the same names."""

    planner: Annotated[Literal[PLANNERS], WholeMap()] = Field(  # type: ignore[valid-type]
        default="astar", description="the sampling planners use the whole time limit"
    )
    neighbours: Literal[8, 16, 32] = Field(
        default=16, description="moves per cell of the grid planners without `refine`; with it they are 32"
    )
    refine: bool = Field(default=True, description="shorten the grid path where it need not follow the grid")
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=5.0, description="how long the sampling planners search [s]"
    )
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="seed of the sampling planners")
    alternatives: Annotated[int, WholeMap()] = Field(
        default=0, ge=0, le=10, description="most other good paths to look for"
    )
    bound: Annotated[bool, WholeMap()] = Field(
        default=False, description="search for a sharper `bound_j`, which takes some seconds once per cost map"
    )
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place, and a goal that cannot be "
        "reached to the nearest place that can, however far that is (`goal_moved_m`); a warning says where",
    )
    furthest_m: float = Field(
        default=COORDINATE_M.high, ge=0.0, le=COORDINATE_M.high, description="furthest that `snap` moves a place [m]"
    )
    start_heading_deg: Annotated[float, within(HEADING_DEG)] | None = Field(
        default=None, description="heading at the start, for a robot with a turning radius [deg, clockwise from north]"
    )
    goal_heading_deg: Annotated[float, within(HEADING_DEG)] | None = Field(
        default=None, description="heading at the goal, for a robot with a turning radius [deg, clockwise from north]"
    )


class PathRequest(SearchOptions, WeighedRequest):
    """From where to where, and how to search."""

    start: Place = Field(examples=[[12.5, 40.5]])
    goal: Place = Field(examples=[[80.0, 15.0]])
    battery: BatteryIn | None = Field(default=None, description="given: the answer says whether this battery lasts")


class Found(NamedTuple):
    """The plan, the map with what it kept off, and whether the battery lasts, where one was given."""

    plan: Plan
    lattice: CostLattice
    verdict: Verdict | None


def ask(planner: RoutePlanner, wanted: PathRequest, *, progress: Callable[[float], None] | None = None) -> Found:
    """Find the best path between two places, and the shortest one beside it."""
    from joulemap.planner.route_planner import RouteOptions
    from joulemap.service.analysis.feasibility import judge_routes
    from joulemap.service.analysis.objectives import plan_by

    asked, lattice = on_map(planner, wanted), planner.lattice
    battery = None if wanted.battery is None else battery_of(wanted.battery, lattice.robot)
    ends = asked.places(wanted.start, "start"), asked.places(wanted.goal, "goal")
    how = RouteOptions(progress=progress, **{name: getattr(wanted, name) for name in SearchOptions.model_fields})
    plan = plan_by(asked.planner, *ends, wanted.chosen_by, how, battery=battery)
    plan, lattice = asked.places.noted(plan), asked.planner.lattice
    return Found(plan, lattice, None if battery is None else judge_routes(lattice, [plan.route], battery))


def answer(found: Found, warnings: list[str]) -> dict[str, Any]:
    """The values of `PathOut`: a model of so many numbers takes longer to make than to write."""
    from joulemap.service.problems import jsonable
    from joulemap.service.schemas.planning import path_points, profile_pieces, route_values, verdict_out

    plan, verdict = found.plan, found.verdict
    route, shortest = plan.route, plan.shortest
    return {
        **route_values(route),
        "profile": profile_pieces([route]),
        "shortest": {"energy_j": shortest.energy_j, "length_m": shortest.length_m, "path": path_points(shortest)},
        "alternatives": [route_values(other) for other in plan.others],
        "saving_j": plan.saving_j,
        "saving_percent": 100.0 * plan.saving_j / shortest.energy_j if shortest.energy_j > 0 else 0.0,
        "battery": verdict_out(verdict).model_dump() if verdict is not None else None,
        "bound_j": plan.bound_j,
        "gap": plan.gap,
        "objective": plan.details.get("objective"),
        "planner": plan.planner,
        "details": jsonable({name: value for name, value in plan.details.items() if name != "objective"}),
        "warnings": [*warnings, *route.notes],
        "crs": route.crs,
    }


def track(found: Found, warnings: list[str]) -> Track:
    """The paths for other programs."""
    from joulemap.service.exports.track import track_of_plan
    from joulemap.service.schemas.planning import verdict_out

    battery = None if found.verdict is None else verdict_out(found.verdict).model_dump()
    return track_of_plan(found.plan, found.lattice, warnings=warnings, battery=battery)
