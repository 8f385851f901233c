"""What a route costs at other speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pydantic import Field

from joulemap.service.questions.parts import OnRoute, on_map
from joulemap.service.schemas.base import GivenPath

if TYPE_CHECKING:  # they take their time to load
    from joulemap.model.energy.predictor import Predictor
    from joulemap.model.terrain.windows import Ground
    from joulemap.planner.route import Route
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.schemas.speeds import SpeedsOut
    from joulemap.service.speeds import Speeds


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


class Found(NamedTuple):
    """What was found, and along which route."""

    speeds: Speeds
    route: Route


def ask(planner: RoutePlanner, wanted: SpeedsRequest, ground: Ground, predictor: Predictor) -> Found:
    """Find what a route costs at every speed that a model knows; `ground` is what the cost map was made of."""
    from joulemap.service.exports.clearance import price_given_path
    from joulemap.service.speeds import speeds_along

    asked, lattice = on_map(planner, wanted), planner.lattice
    if wanted.path is not None:
        route = price_given_path(lattice, asked.places.path(wanted.path))
    else:
        ends = asked.places(wanted.start, "start"), asked.places(wanted.goal, "goal")
        route, lattice = asked.planner.plan(*ends, snap=wanted.snap).route, asked.planner.lattice
    found = speeds_along(route, lattice, ground, predictor, by_stretch=wanted.by_stretch, deadline_s=wanted.deadline_s)
    return Found(found, asked.places.noted(route))


def answer(found: Found, warnings: list[str]) -> SpeedsOut:
    """As it is sent."""
    from joulemap.service.schemas.speeds import speeds_out

    return speeds_out(found.speeds, found.route, warnings)
