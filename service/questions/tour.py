"""Several places and home again, in the order that takes least energy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from pydantic import Field

from joulemap.model.ranges import MAX_STOPS, SEARCH_S
from joulemap.service.questions.parts import BatteryIn, OnMap, battery_of, on_map
from joulemap.service.schemas.base import Place, Request, within

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.planner.answers import RoundTrip
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.planner.verdict.budget import Verdict
    from joulemap.service.exports.track import Track
    from joulemap.service.schemas.tours import TourOut


class TourOptions(Request):
    """How to search: `RoutePlanner.tour` takes these by the same names."""

    neighbours: Literal[8, 16, 32] = Field(default=16, description="moves per cell of the search")
    refine: bool = Field(default=True, description="shorten the legs where they need not follow the grid")
    snap: bool = Field(
        default=False, description="move stops on blocked ground to the nearest free place; warnings say where that is"
    )
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=10.0, description="longest time for proving that the order is the best one [s]"
    )


class TourRequest(TourOptions, OnMap):
    """Places to visit, and how to search. The service finds the order."""

    stops: list[Place] = Field(
        min_length=2,
        max_length=MAX_STOPS,
        description="places to visit, world [x, y] [m]; the first is where the tour begins and ends",
        examples=[[[12.5, 40.5], [80.0, 15.0], [60.0, 50.0]]],
    )
    battery: BatteryIn | None = Field(
        default=None, description="given: the answer says whether this battery lasts for the whole tour"
    )


class Found(NamedTuple):
    """The tour, the map with what it kept off, and whether the battery lasts, where one was given."""

    trip: RoundTrip
    lattice: CostLattice
    verdict: Verdict | None


def ask(planner: RoutePlanner, wanted: TourRequest, *, progress: Callable[[float], None] | None = None) -> Found:
    """Find the round trip of least energy that visits all stops and returns to the first one."""
    from joulemap.service.feasibility import judge_routes

    asked = on_map(planner, wanted)
    stops = [asked.places(stop, f"stop {k}") for k, stop in enumerate(wanted.stops)]
    options = {name: getattr(wanted, name) for name in TourOptions.model_fields}
    trip = asked.places.noted(asked.planner.tour(stops, progress=progress, **options))
    lattice, verdict = asked.planner.lattice, None
    if wanted.battery is not None:
        verdict = judge_routes(lattice, trip.legs, battery_of(wanted.battery, lattice.robot))
    return Found(trip, lattice, verdict)


def answer(found: Found, warnings: list[str]) -> TourOut:
    """As it is sent."""
    from joulemap.service.schemas.tours import tour_out

    return tour_out(found.trip, found.verdict, warnings)


def track(found: Found, warnings: list[str]) -> Track:
    """The legs for other programs."""
    from joulemap.service.exports.track import track_of_tour

    return track_of_tour(found.trip, found.lattice, warnings=warnings)
