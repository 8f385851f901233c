"""What several questions share: the battery, what no route may touch, what the route is chosen by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.model.ranges import BATTERY, BATTERY_CURVES, CURVE_POINTS, OBJECTIVES, QUANTILE, Range
from joulemap.service.questions.given import checked
from joulemap.service.schemas.base import Areas, GivenPath, InPython, Place, Request, RobotIn, WholeMap, within

if TYPE_CHECKING:  # they take their time to load
    from joulemap.model.robot import Robot
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.objectives import Objective
    from joulemap.service.places.places import Places


class OnMap(Request):
    """A question to a cost map."""

    avoid: Areas = Field(default=[])
    robot: Annotated[RobotIn | None, InPython()] = Field(
        default=None, description="refused where it differs from the cost map's robot"
    )

    @classmethod
    def of(cls, **values: Any) -> Self:
        """A question of a Python user, checked as HTTP checks a body.

        Areas may be given in many forms, and are checked by what reads them.
        """
        avoid = values.pop("avoid", None)
        asked = checked(cls, values)
        return asked if avoid is None else asked.model_copy(update={"avoid": avoid})


class WeighedRequest(OnMap):
    """A question whose routes may be chosen by more than their expected energy."""

    objective: Annotated[Literal[OBJECTIVES], WholeMap()] = Field(  # type: ignore[valid-type]
        default="mean",
        description="what the best route is: least expected energy (mean), least energy at a quantile (quantile), or "
        "most likely to arrive with the reserve of the battery (arrival). The last two need a model that knows its "
        "uncertainty, and take a few searches instead of one",
    )
    quantile: Annotated[float, within(QUANTILE)] = Field(
        default=0.95,
        description="with the objective quantile: share of drives that take no more energy than what is made least",
    )
    max_power_w: Annotated[Annotated[float, within(BATTERY["max_power_w"])] | None, WholeMap()] = Field(
        default=None,
        description="most power at the robot's speed [W]; where and in which headings driving takes more is blocked",
    )

    @property
    def chosen_by(self) -> Objective:
        """The objective that was asked for."""
        from joulemap.service.analysis.objectives import Objective

        return Objective(self.objective, self.quantile)


class OnRoute(OnMap):
    """A question about a given path, or about the best one from start to goal."""

    path: GivenPath | None = Field(
        default=None, min_length=2, max_length=100_000, description="world points [m], in order"
    )
    start: Place | None = Field(default=None, examples=[[12.5, 40.5]])
    goal: Place | None = Field(default=None, examples=[[80.0, 15.0]])
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place; a warning says where that is. A "
        "goal that cannot be reached has no verdict unless the nearest place that can is within the robot's length or "
        "three cells. A given path is never moved",
    )

    @model_validator(mode="after")
    def _one_task(self) -> Self:
        ends = (self.start is not None) + (self.goal is not None)
        if (self.path is None and ends < 2) or (self.path is not None and ends > 0):
            raise ValueError("give either `path`, or `start` and `goal`")
        return self


def _curve_of(name: str) -> Any:
    """The type of a battery's curve: points of two numbers, within the bounds of either."""
    at, value = BATTERY_CURVES[name]
    number = Annotated[float, within(Range(min(at.low, value.low), max(at.high, value.high)))]
    return list[Annotated[list[number], Field(min_length=2, max_length=2)]]


class BatteryIn(Request):
    """A battery. What is left out is as in the robot's own battery, full and without a reserve.

    With capacity, charge, reserve, health and temperature alone, a verdict counts energy. Once one of `open_circuit_v`,
    `resistance_ohm`, `cutoff_v` and `max_power_w` is given, it counts losses inside the battery and its voltage under
    the power of every metre too.
    """

    capacity_wh: Annotated[float, within(BATTERY["capacity_wh"])] | None = Field(
        default=None, description="energy when full [Wh]; default: that of the robot", examples=[280.0]
    )
    charge: Annotated[float, within(BATTERY["charge"])] = Field(
        default=1.0,
        description="state of charge at the start, 0..1 (0.6 is 60 %)",
        examples=[0.8],
    )
    reserve: Annotated[float, within(BATTERY["reserve"])] = Field(
        default=0.0,
        description="share of the capacity that must remain at the end, 0..1",
        examples=[0.2],
    )

    health: Annotated[float, within(BATTERY["health"])] = Field(
        default=1.0, description="share of the capacity that age has left, 0.05..1"
    )
    temperature_c: Annotated[float, within(BATTERY["temperature_c"])] | None = Field(
        default=None, description="temperature of the battery [degC]; below 15 degC it needs `capacity_curve`"
    )
    capacity_curve: _curve_of("capacity_curve") | None = Field(  # type: ignore[valid-type]
        default=None,
        min_length=2,
        max_length=CURVE_POINTS,
        description="points [temperature in degC, share of the capacity that the battery gives there], ascending",
        examples=[[[-20.0, 0.6], [0.0, 0.85], [20.0, 1.0]]],
    )
    nominal_voltage_v: Annotated[float, within(BATTERY["nominal_voltage_v"])] | None = Field(
        default=None, description="nominal voltage [V]; default: that of the robot"
    )
    open_circuit_v: _curve_of("open_circuit_v") | None = Field(  # type: ignore[valid-type]
        default=None,
        min_length=2,
        max_length=CURVE_POINTS,
        description="points [state of charge, voltage without a load in V] from 0 to 1, ascending; default: the curve "
        "of a plain lithium-ion pack of the nominal voltage",
        examples=[[[0.0, 21.0], [0.2, 26.5], [1.0, 33.2]]],
    )
    resistance_ohm: Annotated[float, within(BATTERY["resistance_ohm"])] | None = Field(
        default=None, description="internal resistance of the pack [ohm]; default: that of a plain pack"
    )
    cutoff_v: Annotated[float, within(BATTERY["cutoff_v"])] | None = Field(
        default=None, description="voltage under load below which the robot switches off [V]; default: a plain pack's"
    )
    max_power_w: Annotated[float, within(BATTERY["max_power_w"])] | None = Field(
        default=None, description="most power that the battery gives [W]; default: no limit of its own"
    )

    @field_validator("charge", "reserve", "health", mode="before")
    @classmethod
    def _no_percentage(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, int | float) and 1 < value <= 100:
            raise ValueError(
                f"{info.field_name} is {value:g}; it lies between 0 and 1: for {value:g} % write {value / 100:g}"
            )
        return value


OwnBattery = Annotated[BatteryIn | None, Field(description="default: the robot's own, full, without a reserve")]
Snap = Annotated[
    bool, Field(description="move places on blocked ground to the nearest free one; warnings say where that is")
]
Neighbours = Annotated[Literal[8, 16, 32], Field(description="directions of a step")]
Confidence = Annotated[
    Annotated[float, within(QUANTILE)] | None,
    Field(description="probability with which the battery must last; null where the expected energy decides"),
]

UNSURE = "the model does not know its uncertainty: the expected energy decides, without a margin"


def battery_of(given: BatteryIn | Mapping[str, Any] | None, robot: Robot) -> Battery:
    """The battery of a question; what is left out is as in the robot's own one, full and without a reserve."""
    values = given.model_dump(exclude_none=True) if isinstance(given, BatteryIn) else given or {}
    return Battery.from_mapping({"capacity_wh": robot.battery_wh, **values})


def unsure_notes(lattice: CostLattice, wanted: Any) -> list[str]:
    """A note where the model gives no odds for the confidence of a question. Raises InputError if that was given."""
    odds = lattice.std_j is not None and lattice.provenance.get("model", {}).get("spread") is not None
    if wanted.confidence is None or odds:
        return []
    if "confidence" in wanted.model_fields_set:
        raise InputError(
            "the model of this cost map does not know its uncertainty, so no confidence can be given: leave it out, or "
            "use a model that was trained or calibrated on runs",
            confidence=wanted.confidence,
        )
    return [UNSURE]


class Asked(NamedTuple):
    """A question on its map: the planner within all limits, and the reader of its places."""

    planner: Any
    places: Places


def on_map(planner: RoutePlanner, wanted: OnMap) -> Asked:
    """Join a planner with the areas and the power that a question keeps its routes to."""
    from joulemap.service.analysis.objectives import limited
    from joulemap.service.places.places import Places

    places, most_w = Places(planner.lattice.frame), getattr(wanted, "max_power_w", None)
    if "avoid" in wanted.model_fields_set:
        planner = planner.avoiding(places.areas(wanted.avoid))
    return Asked(planner if most_w is None else limited(planner, most_w), places)
