"""Planners of the same map at other prices: with the variance of every metre as a part of its price."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError
from joulemap.planner.any_angle.best import best_path
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import MoveTable, table_of
from joulemap.planner.route import Route, price_route
from joulemap.planner.route_planner import ANY_ANGLE_NEIGHBOURS, RoutePlanner

Array = NDArray[np.float32]


class Weighing:
    """Finds the cheapest ways of a map at prices mean + price variance.

    Parameters
    ----------
    planner : RoutePlanner
        Of a lattice with standard deviations.
    correlation_m : float
        Sum of the correlations of the errors of neighbouring metres [m]: the variance of a long route is that of its
        metres times this.
    per_std_j : float, default 0
        Variance that a metre adds for each joule of its standard deviation, because the errors of a whole run have it
        in common [J].
    """

    def __init__(self, planner: RoutePlanner, correlation_m: float, *, per_std_j: float = 0.0) -> None:
        std_j = planner.lattice.std_j
        assert std_j is not None
        self._planner = planner
        self._variance = np.float32(correlation_m) * np.square(std_j) + np.float32(per_std_j) * std_j
        self._of_moves: dict[int, Array] = {}

    def cheapest(
        self, start: Points, goal: Points, price: float, *, neighbours: int = ANY_ANGLE_NEIGHBOURS, refine: bool = True
    ) -> tuple[Route, float]:
        """Return the cheapest way at a price.

        `start`, `goal` (2,): fractional (row, col); `price`: of variance [1/J]; `neighbours`: moves per cell; `refine`:
        whether the path is improved to any angle. Returns `route`: priced at its mean energy; `least_j`: what no path
        over grid moves is cheaper than [J]. Raises NoRouteError if there is no way.
        """
        table = self.table(price, neighbours)
        if refine:
            best = best_path(weighed(self._planner.lattice, self._variance, price), table, start, goal)
            with suppress(BlockedError):  # a limit of power is known to the moves, and not to prices of any angle
                return self._route(best.points), best.grid_energy_j
        path = grid_search(self._planner.lattice, table, start, goal)  # the legs to the first and from the last centre
        return self._route(path.points), path.energy_j  # have no variance, and stay within the limit

    def table(self, price: float, neighbours: int) -> MoveTable:
        """Return the moves at a price.

        `price`: of variance [1/J]; `neighbours`: moves per cell. Result: exact: the mean and the variance of a move add
        up.
        """
        lattice, base = self._planner.lattice, self._planner._table(neighbours, distance=False)
        lifted = lattice.robot.weight_n * np.nan_to_num(lattice.elevation_m.astype(np.float64))
        return table_of(
            base.energy + np.float32(price) * self.variances(neighbours),
            base.offsets,
            lifted,
            spacing_m=lattice.frame.resolution_m,
            turn_j_per_rad=lattice.robot.turn_j_per_rad,
        )

    def variances(self, neighbours: int) -> Array:
        """Return the variance of every move.

        `neighbours`: moves per cell. Result (rows, cols, N): [J2]; NaN where it may not be driven.
        """
        if neighbours not in self._of_moves:
            lattice = self._planner.lattice
            robot = replace(lattice.robot, idle_power_w=0.0, regeneration=0.0)
            flat = replace(lattice, robot=robot, traction_per_m=self._variance, max_traction_per_m=np.inf)
            self._of_moves[neighbours] = MovePrices(lattice.headings, neighbours).by_cell(flat)
        return self._of_moves[neighbours]

    def _route(self, points: Points) -> Route:
        lattice = self._planner.lattice
        return price_route(lattice, np.column_stack(lattice.frame.xy(points[:, 0], points[:, 1])))


def weighed(lattice: CostLattice, variance: Array, price: float) -> CostLattice:
    """Return a lattice whose prices hold the variance of every metre.

    `lattice`: prices and limits; `variance` (rows, cols, headings): of a metre [J2/m]; `price`: of variance [1/J].
    Result: at cell centres and heading bins its price is mean + price variance. Where the brakes take all of the energy
    of a descent, prices between them are those of an interpolated price, a little above.
    """
    if price == 0.0:
        return lattice
    share = lattice.robot.regeneration
    traction = lattice.traction_per_m
    paid = np.maximum(traction, 0.0) + np.float32(share) * np.minimum(traction, 0.0) + np.float32(price) * variance
    if share > 0.0:
        paid = np.where(paid < 0.0, paid / np.float32(share), paid)
    return replace(lattice, traction_per_m=paid, max_traction_per_m=np.inf)
