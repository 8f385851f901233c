"""RRT*, Informed RRT* and BIT* of OMPL, which is loaded by the first question to one of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner.planners.contract import Options, Planner

if TYPE_CHECKING:  # names of planners are listed without what searches
    from joulemap.planner.grid.search import GridPath
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.pricing.integrator import Points
    from joulemap.planner.pricing.moves import MoveTable

    Found = tuple[Points, dict[str, Any]]


def _tree(lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options, *, name: str) -> Found:
    """From the grid, sample only where its two energy fields leave room for a better path."""
    from joulemap.planner.sampling.trees import informed_subset, sample_route

    settings = _settings(options)
    if not options.from_grid:
        return sample_route(lattice, start, goal, planner=name, **settings)

    def improve(grid: GridPath) -> Found:
        places = informed_subset(lattice, table, start, goal)
        return sample_route(lattice, start, goal, planner=name, places=places, **settings)

    return _from_grid(lattice, table, start, goal, improve)


def _bitstar(lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options) -> Found:
    """From the grid, sample in corridors around its path."""
    from joulemap.planner.sampling.trees import sample_along, sample_route

    settings = _settings(options)
    if not options.from_grid:
        return sample_route(lattice, start, goal, planner="bitstar", **settings)
    return _from_grid(lattice, table, start, goal, lambda grid: sample_along(lattice, grid.points, **settings))


def _settings(options: Options) -> dict[str, Any]:
    if not 0 <= options.seed < 2**31:
        raise InputError(f"`seed` must lie in 0..{2**31 - 1}, got {options.seed}", seed=str(options.seed))
    return {"time_limit_s": options.time_limit_s, "seed": options.seed, "progress": options.progress}


def _from_grid(
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points, improve: Callable[[GridPath], Found]
) -> Found:
    """The better of the grid's path and of what sampling makes of it."""
    from joulemap.planner.grid.search import grid_search
    from joulemap.planner.pricing.integrator import path_price

    grid = grid_search(lattice, table, start, goal)
    details: dict[str, Any] = {"grid_energy_j": grid.energy_j}
    try:
        points, found = improve(grid)
    except NoRouteError:  # in so short a time: no path is in its history
        return grid.points, details | {"history": []}
    better = path_price(lattice, points) < path_price(lattice, grid.points)
    return points if better else grid.points, details | found


_sampling = partial(Planner, uses_time_limit=True, weighs_turning=False)
RRTSTAR = _sampling("rrtstar", partial(_tree, name="rrtstar"))
INFORMED_RRTSTAR = _sampling("informed_rrtstar", partial(_tree, name="informed_rrtstar"))
BITSTAR = _sampling("bitstar", _bitstar)
