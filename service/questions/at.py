"""What driving costs at one place, in every direction."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from joulemap.service.questions.parts import OnMap, on_map
from joulemap.service.schemas.base import Place

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.point_costs import PointCosts
    from joulemap.service.schemas.maps import AtOut


class AtRequest(OnMap):
    """Where."""

    place: Place


class Found(NamedTuple):
    """The prices, and where: world x, y [m]."""

    costs: PointCosts
    x: float
    y: float


def ask(planner: RoutePlanner, wanted: AtRequest) -> Found:
    """Look up the prices at a place."""
    from joulemap.service.analysis.point_costs import costs_at

    asked = on_map(planner, wanted)
    x, y = asked.places(wanted.place, "point")
    asked.planner.read_along([(x, y)])
    return Found(costs_at(asked.planner.lattice, x, y), x, y)


def answer(found: Found) -> AtOut:
    """As it is sent."""
    import numpy as np

    from joulemap.service.schemas.maps import AtOut
    from joulemap.service.schemas.planning import number

    costs = found.costs
    return AtOut(
        x=found.x,
        y=found.y,
        elevation_m=number(costs.elevation_m),
        headings_deg=np.rad2deg(costs.headings_rad).tolist(),
        energy_per_m=[number(v) for v in costs.energy_per_m.tolist()],
        blocked=costs.reasons,
    )
