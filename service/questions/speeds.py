"""What a route costs at other speeds."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Literal, NamedTuple

from pydantic import Field

from joulemap.service.questions.parts import OnRoute, on_map
from joulemap.service.schemas.base import GivenPath, Point3, ResponseModel

if TYPE_CHECKING:  # they take their time to load
    from joulemap.model.energy.predictor import Predictor
    from joulemap.model.terrain.windows import Ground
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route import Route
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.speeds import Speeds
    from joulemap.service.exports.track import Track


class SpeedsRequest(OnRoute):
    """A route: either a path, or start and goal."""

    path: GivenPath | None = Field(
        default=None, min_length=2, max_length=5_000, description="world points [m], in order"
    )
    by_stretch: bool = Field(default=False, description="also find a speed for each stretch, of least energy")
    deadline_s: float | None = Field(
        default=None,
        gt=0.0,
        le=1e7,
        description="time for the route [s]; gives a speed for each stretch",
    )


class AtSpeedOut(ResponseModel):
    """The route at one speed."""

    speed_mps: float = Field(description="cruising speed [m/s]")
    energy_j: float = Field(description="energy of the route, idle power and turns included [J]")
    duration_s: float = Field(description="time, turns on the spot not counted [s]")


class SpeedProfileOut(ResponseModel):
    """A speed for each stretch of the route."""

    until_m: list[float] = Field(description="where each stretch ends, from the start [m]")
    speed_mps: list[float] = Field(description="its speed [m/s]")
    energy_j: float = Field(description="energy, idle power, changes of speed and turns included [J]")
    duration_s: float = Field(description="time, turns on the spot not counted [s]")


class SpeedsOut(ResponseModel):
    """Energy against time along one route, at the speeds that the model learned from."""

    text: str = Field(description="the answer in one sentence")
    cheapest: AtSpeedOut = Field(description="the speed of least energy")
    declared: AtSpeedOut | None = Field(description="the robot's own speed; null where the model does not know it")
    curve: list[AtSpeedOut] = Field(description="from the slowest to the fastest speed that the model knows")
    at_border: Literal["slowest", "fastest"] | None = Field(
        description="where the cheapest speed is at the border of what the model knows"
    )
    profile: SpeedProfileOut | None = Field(description="a speed for each stretch; null where it was not asked for")
    source: str = Field(description="where the range of speeds comes from")
    length_m: float = Field(description="horizontal length of the route [m]")
    path: list[Point3] = Field(repr=False)
    warnings: list[str]


class Found(NamedTuple):
    """What was found, along which route, and on which map."""

    speeds: Speeds
    route: Route
    lattice: CostLattice


def ask(planner: RoutePlanner, wanted: SpeedsRequest, ground: Ground, predictor: Predictor) -> Found:
    """Find what a route costs at every speed that a model knows; `ground` is what the cost map was made of."""
    from joulemap.planner.route_planner import RouteOptions
    from joulemap.service.analysis.speeds import speeds_along
    from joulemap.service.exports.clearance import price_given_path

    asked, lattice = on_map(planner, wanted), planner.lattice
    if wanted.path is not None:
        route = price_given_path(lattice, asked.places.path(wanted.path))
    else:
        ends = asked.places(wanted.start, "start"), asked.places(wanted.goal, "goal")
        route, lattice = asked.planner.plan(*ends, RouteOptions(snap=wanted.snap)).route, asked.planner.lattice
    found = speeds_along(route, lattice, ground, predictor, by_stretch=wanted.by_stretch, deadline_s=wanted.deadline_s)
    return Found(found, asked.places.noted(route), lattice)


def answer(found: Found, warnings: list[str]) -> SpeedsOut:
    """As it is sent."""
    from joulemap.service.schemas.planning import path_points

    return SpeedsOut(
        text=f"{found.speeds}.",
        **asdict(found.speeds),
        length_m=found.route.length_m,
        path=path_points(found.route),
        warnings=[*warnings, *found.route.notes],
    )


def track(found: Found, warnings: list[str]) -> Track:
    """The route for other programs, at the cheapest speed, or with a speed for each stretch where those were found."""
    from joulemap.service.exports.track import OPTIMAL, Track, line_of

    profile, best = found.speeds.profile, found.speeds.cheapest
    stretches = () if profile is None else tuple(zip(profile.until_m, profile.speed_mps, strict=True))
    line = line_of(found.route, OPTIMAL, speeds_mps=[best.speed_mps] if profile is None else list(profile.speed_mps))
    extra = {"warnings": [*found.route.notes, *warnings]}
    return Track("joulemap speeds", (line,), found.route.crs, best.speed_mps, found.lattice, extra, stretches)
