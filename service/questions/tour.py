"""Several places, in the order that takes least energy or as given, and home again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import Field

from joulemap.model.ranges import MAX_STOPS, SEARCH_S
from joulemap.service.questions.parts import BatteryIn, Neighbours, OnMap, Snap, battery_of, on_map
from joulemap.service.schemas.base import Place, Request, within

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.planner.answers import RoundTrip
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.planner.verdict.budget import Verdict
    from joulemap.service.exports.track import Track
    from joulemap.service.schemas.planning import TourOut


class TourOptions(Request):
    """How to search: `RoutePlanner.tour` takes these by the same names."""

    neighbours: Neighbours = 16
    refine: bool = Field(default=True, description="shorten the legs where they need not follow the grid")
    snap: Snap = False
    in_order: bool = Field(default=False, description="visit the stops in the order in which they are given")
    one_way: bool = Field(default=False, description="end at the last of the given stops, and do not return")
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=10.0, description="longest time for proving that the order is the best one [s]"
    )


class TourRequest(TourOptions, OnMap):
    """Places to visit, and how to search. The service finds the order, unless the given one is asked for."""

    stops: list[Place] = Field(
        min_length=2,
        max_length=MAX_STOPS,
        description="places to visit, world x, y [m]; the first is where the tour begins, and ends unless `one_way`",
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
    """Find the tour of least energy that visits all stops."""
    from joulemap.service.analysis.feasibility import judge_routes

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
    from joulemap.service.analysis.route_uncertainty import quantiles_of_route
    from joulemap.service.schemas.planning import RouteOut, TourOut, profile_pieces, route_values, verdict_out

    trip, verdict = found.trip, found.verdict
    legs = [RouteOut(**route_values(leg)) for leg in trip.legs]
    sums = ("energy_j", "energy_wh", "length_m", "duration_s", "climb_m", "descent_m")
    of_all: dict[str, Any] = {name: sum(getattr(leg, name) for leg in legs) for name in sums}
    of_all |= quantiles_of_route(*trip.legs)
    radii = [leg.tightest_radius_m for leg in legs if leg.tightest_radius_m is not None]
    return TourOut(
        **of_all,
        tightest_radius_m=min(radii, default=None),
        path=[*legs[0].path, *(point for leg in legs[1:] for point in leg.path[1:])],
        order=list(trip.order),
        profile=profile_pieces(trip.legs),
        legs=legs,
        grid_energy_j=trip.grid_energy_j,
        bound_j=trip.bound_j,
        proven=trip.proven,
        battery=verdict_out(verdict) if verdict is not None else None,
        warnings=[*warnings, *trip.notes],
        crs=trip.legs[0].crs,
    )


def track(found: Found, warnings: list[str]) -> Track:
    """The legs for other programs."""
    from joulemap.service.exports.track import track_of_tour

    return track_of_tour(found.trip, found.lattice, warnings=warnings)
