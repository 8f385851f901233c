"""A tour: its request and its answer, over HTTP and on the command line."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from joulemap.planner.answers import RoundTrip
from joulemap.planner.verdict.budget import Verdict
from joulemap.service.route_uncertainty import quantiles_of_route
from joulemap.service.schemas.answers import profile_pieces, route_values, verdict_out
from joulemap.service.schemas.planning import PieceOut, RouteOut, VerdictOut


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
