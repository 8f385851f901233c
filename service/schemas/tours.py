"""A tour: its request and its answer, over HTTP and on the command line."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from joulemap.model.ranges import SEARCH_S
from joulemap.planner.answers import RoundTrip
from joulemap.planner.questions.tours import MAX_STOPS
from joulemap.planner.verdict.budget import Verdict
from joulemap.service.route_uncertainty import quantiles_of_route
from joulemap.service.schemas.answers import profile_pieces, route_values, verdict_out
from joulemap.service.schemas.base import Areas, Place, Request, RobotIn, within
from joulemap.service.schemas.planning import BatteryIn, PieceOut, RouteOut, VerdictOut


class TourRequest(Request):
    """Places to visit, and how to search. The service finds the order."""

    stops: list[Place] = Field(
        min_length=2,
        max_length=MAX_STOPS,
        description="places to visit, world [x, y] [m]; the first is where the tour begins and ends",
        examples=[[[12.5, 40.5], [80.0, 15.0], [60.0, 50.0]]],
    )
    neighbours: Literal[8, 16, 32] = Field(default=16, description="moves per cell of the search")
    refine: bool = Field(default=True, description="shorten the legs where they need not follow the grid")
    snap: bool = Field(
        default=False, description="move stops on blocked ground to the nearest free place; warnings say where that is"
    )
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=10.0, description="longest time for proving that the order is the best one [s]"
    )
    avoid: Areas = Field(default=[])
    battery: BatteryIn | None = Field(
        default=None, description="given: the answer says whether this battery lasts for the whole tour"
    )
    robot: RobotIn | None = Field(default=None, description="refused where it differs from the cost map's robot")


class TourOut(RouteOut):
    """The round trip of least energy. Turning on arrival at a stop is not counted."""

    order: list[int] = Field(
        description="numbers of the stops in the order of the visit, 0 first", examples=[[0, 2, 1]]
    )
    profile: list[PieceOut] = Field(repr=False, description="energy and height along the whole tour")
    legs: list[RouteOut] = Field(description="from each stop to the next, and from the last back to the first")
    grid_energy_j: float = Field(description="energy of the tour along the grid, before `refine` [J]")
    bound_j: float = Field(description="lower bound of the energy of any order along the grid [J]")
    proven: bool = Field(description="whether no other order costs less energy along the grid")
    battery: VerdictOut | None = Field(description="whether the battery lasts; null unless asked for")
    warnings: list[str]
    crs: str | None


def tour_out(trip: RoundTrip, verdict: Verdict | None, warnings: list[str]) -> TourOut:
    """Return the answer to the question for a tour.

    Parameters
    ----------
    trip : RoundTrip
        From the planner.
    verdict : Verdict or None
        None where none was asked for.
    warnings : list of str
        Of the cost map.

    Returns
    -------
    TourOut
        With its legs.
    """
    legs = [RouteOut(**route_values(leg)) for leg in trip.legs]
    sums = ("energy_j", "energy_wh", "length_m", "duration_s", "climb_m", "descent_m")
    of_all: dict[str, Any] = {name: sum(getattr(leg, name) for leg in legs) for name in sums}
    of_all |= quantiles_of_route(*trip.legs)
    return TourOut(
        **of_all,
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
