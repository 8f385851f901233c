"""The same question to several cost maps: robots or models side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError, InputError
from joulemap.planner.route import Route, price_route
from joulemap.service.library.planned import PlannedRoute, route_numbers
from joulemap.service.library.shown import Shown
from joulemap.service.words import energy_words, route_words

if TYPE_CHECKING:
    from joulemap.planner.lattice import CostLattice
    from joulemap.service.library.costmaps import CostMap, Point


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown):
    """The cheapest routes of several cost maps, and what each of them costs on the others.

    Attributes
    ----------
    routes : dict of str to PlannedRoute
        For each map its own route.
    energies_j : ndarray of float, (maps, routes)
        Energy of each route on each map [J]; infinite where the map's robot may not drive it.
    """

    routes: dict[str, PlannedRoute]
    energies_j: NDArray[np.float64]

    def _title(self) -> str:
        return "Routes side by side"

    def _rows(self) -> dict[str, str]:
        rows = {name: route_words(route_numbers(route.route)) for name, route in self.routes.items()}
        for name, energies in zip(self.routes, self.energies_j, strict=True):
            others = (
                f"{other}'s {'may not be driven' if np.isinf(energy) else energy_words(energy)}"
                for other, energy in zip(self.routes, energies, strict=True)
                if other != name
            )
            rows[f"{name} on the route of"] = ", ".join(others)
        return rows

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.routes)}>"


def compare(costmaps: Mapping[str, CostMap], start: Point, goal: Point, **how: Any) -> Comparison:
    """Plan between the same places on several cost maps: of other robots, models or ground.

    Parameters
    ----------
    costmaps : mapping of str to CostMap
        Cost maps in the same coordinate system, by the names that the answer shall give them.
    start, goal : place
        As of `CostMap.plan`.
    **how
        Further options of `CostMap.plan`.

    Returns
    -------
    Comparison
        Each map's own route, and the energy of every route on every map.

    Raises
    ------
    InputError
        If there are fewer than two cost maps, or their coordinate systems differ.
    PointError, BlockedError, NoRouteError
        As of `CostMap.plan`.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> hill = jm.heightmap(np.tile(np.linspace(0.0, 3.0, 60), (40, 1)), resolution_m=0.5)
    >>> light, heavy = (jm.costmap(hill, jm.Robot(mass_kg=m), model="physics") for m in (20.0, 60.0))
    >>> side_by_side = jm.compare({"light": light, "heavy": heavy}, (3.0, 10.0), (27.0, 10.0))
    >>> bool(np.all(side_by_side.energies_j[1] > side_by_side.energies_j[0]))
    True
    """
    if len(costmaps) < 2:
        raise InputError(f"a comparison needs two cost maps or more, got {len(costmaps)}")
    systems = {name: each.crs for name, each in costmaps.items()}
    if len(set(systems.values())) > 1:
        said = ", ".join(f"{name} in {crs}" for name, crs in systems.items())
        raise InputError(f"the cost maps have different coordinate systems: {said}")
    routes = {name: each.plan(start, goal, **how) for name, each in costmaps.items()}
    energies = [[_energy_j(each.lattice, route.route) for route in routes.values()] for each in costmaps.values()]
    return Comparison(routes, np.array(energies))


def _energy_j(lattice: CostLattice, route: Route) -> float:
    try:
        return price_route(lattice, route.points[:, :2]).energy_j
    except BlockedError:
        return float("inf")
