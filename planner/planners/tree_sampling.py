"""RRT*, Informed RRT* and BIT* of OMPL, which is loaded by the first question to one of them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from joulemap.planner.planners.contract import Options, Planner

if TYPE_CHECKING:  # names of planners are listed without what searches
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.pricing.integrator import Points
    from joulemap.planner.pricing.moves import MoveTable


def _sampled(
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options, *, name: str
) -> tuple[Points, dict[str, Any]]:
    from joulemap.planner.sampling.trees import sample_route

    time_limit_s, seed, progress = options.time_limit_s, options.seed, options.progress
    return sample_route(lattice, start, goal, planner=name, time_limit_s=time_limit_s, seed=seed, progress=progress)


def _planner(name: str) -> Planner:
    return Planner(name, partial(_sampled, name=name), uses_time_limit=True, weighs_turning=False)


RRTSTAR, INFORMED_RRTSTAR, BITSTAR = (_planner(name) for name in ("rrtstar", "informed_rrtstar", "bitstar"))
