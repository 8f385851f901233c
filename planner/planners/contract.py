"""What a planner is: a name and a function from a question to a polyline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:  # names of planners are listed without what searches
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.pricing.integrator import Points
    from joulemap.planner.pricing.moves import MoveTable


@dataclass(frozen=True, eq=False, repr=False)
class Options:
    """What a caller may set for a search; a planner uses what concerns it.

    Attributes
    ----------
    time_limit_s : float
        Longest time for planners that search until it is over [s].
    seed : int
        Seed of planners that draw random numbers.
    progress : callable or None
        Called with the share of the time limit that is over, 0..1.
    """

    time_limit_s: float = 5.0
    seed: int = 0
    progress: Callable[[float], None] | None = None


class Search(Protocol):
    """The search function of a planner."""

    def __call__(
        self, lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options, /
    ) -> tuple[Points, dict[str, Any]]:
        """Return a path from start to goal.

        Parameters
        ----------
        lattice : CostLattice
            Prices and limits.
        table : MoveTable
            The priced moves of the lattice with the number of neighbours that was asked for.
        start, goal : ndarray of float, (2,)
            Fractional (row, col), joined to at least one cell centre around it.
        options : Options
            What the caller set.

        Returns
        -------
        points : ndarray of float, (n, 2)
            (row, col) polyline from `start` to `goal` whose legs may all be driven.
        details : dict
            JSON-able record of how it was found.

        Raises
        ------
        NoRouteError
            If no path was found.
        """


@dataclass(frozen=True)
class Planner:
    """A planner: a name, a search, and what callers must know of it.

    Whatever it returns is improved at any angle if the caller wants it, priced by `edges` and compared with the
    shortest path, as for every planner.

    Attributes
    ----------
    name : str
        What callers ask for.
    search : Search
        The search function.
    uses_time_limit : bool
        Whether it searches until `Options.time_limit_s` is over.
    weighs_turning : bool
        Whether the search counts the robot's turn cost; where not, the answer says so.
    """

    name: str
    search: Search
    uses_time_limit: bool = False
    weighs_turning: bool = True
