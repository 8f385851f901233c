"""Whether a battery lasts for a path, or for the best route between two places."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

from pydantic import Field, model_validator

from joulemap.service.questions.parts import OnRoute, OwnBattery, WeighedRequest, battery_of, on_map
from joulemap.service.schemas.base import InPython

if TYPE_CHECKING:  # they take their time to load
    from joulemap.model.battery import Battery
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.feasibility import Assessment
    from joulemap.service.exports.track import Track


class FeasibilityRequest(OnRoute, WeighedRequest):
    """A task, either a path or start and goal, and a battery."""

    round_trip: bool = Field(
        default=False, description="also drive back: a given path in reverse, else the best way back"
    )
    battery: OwnBattery = None
    profile: Annotated[bool, InPython()] = Field(
        default=False, description="also answer charge and voltage along the way"
    )

    @model_validator(mode="after")
    def _nothing_to_choose(self) -> Self:
        if self.path is not None and (self.objective != "mean" or self.max_power_w is not None):
            raise ValueError("`objective` and `max_power_w` choose a path: give `start` and `goal` in place of `path`")
        return self


class Found(NamedTuple):
    """The verdict with its routes, the map, the battery, and whether its course along the way is wanted."""

    assessment: Assessment
    lattice: CostLattice
    battery: Battery
    profile: bool


def ask(planner: RoutePlanner, wanted: FeasibilityRequest) -> Found:
    """Judge a given path, or the best one from start to goal; a given path is only priced."""
    from joulemap.service.analysis.feasibility import assess

    asked, battery = on_map(planner, wanted), battery_of(wanted.battery, planner.lattice.robot)
    task: dict[str, Any] = {name: getattr(wanted, name) for name in ("path", "start", "goal", "round_trip", "snap")}
    assessment = assess(asked.planner, battery=battery, objective=wanted.chosen_by, **task)
    return Found(assessment, asked.planner.lattice, battery, wanted.profile)


def answer(found: Found, warnings: list[str]) -> dict[str, Any]:
    """The values of `FeasibilityOut`."""
    from joulemap.planner.verdict.budget import battery_along
    from joulemap.planner.words import moved_words
    from joulemap.service.schemas.planning import battery_pieces, route_values, verdict_out

    assessment, volts = found.assessment, found.lattice.robot.nominal_voltage_v
    routes = assessment.routes
    along = battery_along(routes, found.battery, volts) if found.profile else None
    verdict = verdict_out(assessment.verdict).model_dump()
    return {
        **verdict,
        "message": verdict["message"] + moved_words(assessment.route_out.goal_moved_m),
        "length_m": sum(r.length_m for r in routes),
        "duration_s": sum(r.duration_s for r in routes),
        "out": route_values(assessment.route_out),
        "back": route_values(routes[1]) if len(routes) == 2 else None,
        "objective": None if assessment.weighed is None else asdict(assessment.weighed),
        "profile": None if along is None else battery_pieces(*along),
        "warnings": [*warnings, *(note for r in routes for note in r.notes)],
    }


def track(found: Found, warnings: list[str]) -> Track:
    """What is driven, for other programs: the way out, and the way back of a round trip."""
    from joulemap.service.exports.track import track_of_task
    from joulemap.service.schemas.planning import verdict_out

    battery = verdict_out(found.assessment.verdict).model_dump()
    return track_of_task(found.assessment.routes, found.lattice, warnings=warnings, battery=battery)
