"""Whether a battery lasts for a path, or for the best route between two places."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Self

from pydantic import Field, model_validator

from joulemap.service.questions.parts import BatteryIn, OnRoute, WeighedRequest, battery_of, on_map

if TYPE_CHECKING:  # they take their time to load
    from joulemap.model.battery import Battery
    from joulemap.planner.lattice import CostLattice
    from joulemap.service.exports.track import Track
    from joulemap.service.feasibility import Assessment
    from joulemap.service.questions.parts import AnyPlanner


class FeasibilityRequest(OnRoute, WeighedRequest):
    """A task, either a path or start and goal, and a battery."""

    round_trip: bool = Field(
        default=False, description="also drive back: a given path in reverse, else the best way back"
    )
    battery: BatteryIn | None = Field(default=None, description="default: the robot's own, full, without a reserve")
    profile: bool = Field(default=False, description="also answer charge and voltage along the way")

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


def ask(planner: AnyPlanner, wanted: FeasibilityRequest) -> Found:
    """Judge a given path, or the best one from start to goal; a given path is only priced."""
    from joulemap.service.feasibility import assess

    asked, battery = on_map(planner, wanted), battery_of(wanted.battery, planner.lattice.robot)
    task: dict[str, Any] = {name: getattr(wanted, name) for name in ("path", "start", "goal", "round_trip", "snap")}
    assessment = assess(asked.planner, battery=battery, objective=wanted.chosen_by, **task)
    return Found(assessment, asked.planner.lattice, battery, wanted.profile)


def answer(found: Found, warnings: list[str]) -> dict[str, Any]:
    """The values of `FeasibilityOut`."""
    from joulemap.planner.verdict.budget import battery_along
    from joulemap.service.schemas.answers import feasibility_values

    volts = found.lattice.robot.nominal_voltage_v
    along = battery_along(found.assessment.routes, found.battery, volts) if found.profile else None
    return feasibility_values(found.assessment, warnings, along=along)


def track(found: Found, warnings: list[str]) -> Track:
    """What is driven, for other programs: the way out, and the way back of a round trip."""
    from joulemap.service.exports.track import track_of_task
    from joulemap.service.schemas.answers import verdict_out

    battery = verdict_out(found.assessment.verdict).model_dump()
    return track_of_task(found.assessment.routes, found.lattice, warnings=warnings, battery=battery)
