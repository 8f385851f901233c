"""The planners by name: one line each in the registry, one module each (or a module for those that are alike)."""

from __future__ import annotations

from joulemap.model.errors import InputError, nearest_name
from joulemap.planner.planners.contract import Options, Planner, Search
from joulemap.planner.planners.grid import ASTAR, DIJKSTRA
from joulemap.planner.planners.tree_sampling import BITSTAR, INFORMED_RRTSTAR, RRTSTAR

__all__ = ["PLANNERS", "Options", "Planner", "Search", "planner_named", "register"]

_REGISTRY: dict[str, Planner] = {}


def register(planner: Planner) -> Planner:
    """Make a planner known by its name.

    Parameters
    ----------
    planner : Planner
        The planner.

    Returns
    -------
    Planner
        The same planner.

    Raises
    ------
    InputError
        If another planner has that name.
    """
    if _REGISTRY.get(planner.name, planner) is not planner:
        raise InputError(f"there is a planner called {planner.name!r} already: choose another name", name=planner.name)
    _REGISTRY[planner.name] = planner
    return planner


def planner_named(name: str) -> Planner:
    """Return the planner of a name.

    Parameters
    ----------
    name : str
        A name in `PLANNERS`, or of a planner that was registered later.

    Returns
    -------
    Planner
        The planner.

    Raises
    ------
    InputError
        If there is none; the message lists the names.
    """
    if name not in _REGISTRY:
        near = nearest_name(str(name), _REGISTRY)
        hint = f"; did you mean {near!r}?" if near else ""
        raise InputError(f"planner must be one of {', '.join(_REGISTRY)}, got {name!r}{hint}", planner=name)
    return _REGISTRY[name]


register(ASTAR)
register(DIJKSTRA)
register(RRTSTAR)
register(INFORMED_RRTSTAR)
register(BITSTAR)

PLANNERS = tuple(_REGISTRY)
"""Names of the planners that joulemap ships."""
