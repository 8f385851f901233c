"""The same task before and after a calibration: the way of the old prices, and what that of the new ones saves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InfeasibleError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice_build import build_lattice
from joulemap.planner.plan import RoutePlanner
from joulemap.planner.route import Route, price_route
from joulemap.service.models import planning_robot
from joulemap.service.route_uncertainty import std_along

FloatArray = NDArray[np.float64]
Point = tuple[float, float]
Task = tuple[Point, Point]

_OTHERS = 5  # tasks tried beside the farthest one
_LEAST_SHARE = 0.4  # of the greatest distance that lies between the ends of those
_DIRECTIONS = 32
_CELLS = 250_000  # about as many has the lattice that routes are compared on


@dataclass(frozen=True, eq=False, repr=False)
class Rerouted:
    """One task. before : the old prices' way at the old prices; repriced : the same way at the new ones; after : the
    new prices' way at the new ones; old_j : its energy at the old ones. std_j : standard deviations of `repriced` and
    `after`, None where they are not known.
    """

    task: Task
    before: Route
    repriced: Route
    after: Route
    old_j: float
    std_j: tuple[float | None, float | None]

    @property
    def saving_j(self) -> float:
        """What the new way saves against the old one, both at the new prices [J]."""
        return self.repriced.energy_j - self.after.energy_j

    @property
    def saving_share(self) -> float:
        return self.saving_j / self.repriced.energy_j if self.repriced.energy_j > 0 else 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """shown : the task that is told of. tried : all of them. given : whether somebody asked for it. turn_j_per_rad :
    what turning costs in plans, before and after. price_per_m : of the map's cells, (rows, cols) [J/m], mean over the
    headings that may be driven, before and after; NaN where there are none. frame : of both.
    """

    shown: Rerouted
    tried: tuple[Rerouted, ...]
    given: bool
    turn_j_per_rad: tuple[float, float]
    frame: GridFrame
    price_per_m: tuple[FloatArray, FloatArray]

    @property
    def chosen(self) -> str:
        """How the task was found, in words."""
        if self.given:
            return "given"
        if len(self.tried) == 1:
            return "between the two places farthest apart that the runs visited"
        return f"of {len(self.tried)} tasks between places that the runs visited, the one whose route gains most"

    def map_as_dict(self) -> dict[str, Any]:
        """What a calibration changes on the map, JSON-able; nineteen places in twenty change by `low` to `high`."""
        before, after = self.price_per_m
        low, high = (float(q) for q in np.nanquantile(after - before, [0.025, 0.975]))
        return {
            "mean_price_per_m": {"before": float(np.nanmean(before)), "after": float(np.nanmean(after))},
            "change_per_m": {"low": low, "high": high},
            "turn_j_per_rad": {"before": self.turn_j_per_rad[0], "after": self.turn_j_per_rad[1]},
        }

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; energies are at the new prices unless they say otherwise."""
        shown = self.shown
        return {
            "task": {"start": list(shown.task[0]), "goal": list(shown.task[1]), "chosen": self.chosen},
            "before": _route(shown.repriced, shown.std_j[0]) | {"energy_at_old_prices_j": shown.before.energy_j},
            "after": _route(shown.after, shown.std_j[1]) | {"energy_at_old_prices_j": shown.old_j},
            "saving_j": shown.saving_j,
            "saving_percent": 100.0 * shown.saving_share,
            "tried": [
                {"start": list(r.task[0]), "goal": list(r.task[1]), "saving_percent": 100.0 * r.saving_share}
                for r in self.tried
            ],
        }


def _route(route: Route, std_j: float | None) -> dict[str, Any]:
    path = route.points[:, :2].round(3).tolist()
    return {"energy_j": route.energy_j, "energy_std_j": std_j, "length_m": route.length_m, "path": path}


def compare_routes(
    heightmap: Heightmap,
    robot: Robot,
    before: Predictor,
    after: Predictor,
    places: FloatArray,
    *,
    task: Task | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Plan a task with both models. places : (n, 2) world points [m] that the runs visited; task : start and goal, or a
    few are drawn of the places, the two farthest apart among them, and the one is shown whose route gains most.

    Raises InfeasibleError where none of the tasks has a route, PointError for a task outside the map.
    """
    west, south, east, north = heightmap.frame.bounds
    spacing = max(1.0, math.ceil(math.sqrt((east - west) * (north - south) / _CELLS)))
    robots = planning_robot(before, robot), planning_robot(after, robot)
    new = build_lattice(heightmap, robots[1], after, spacing_m=spacing)
    # an effect may be unknown where the base model is not: both go where both know
    old = replace(build_lattice(heightmap, robots[0], before, spacing_m=spacing), blocked=new.blocked)
    planners = RoutePlanner(old), RoutePlanner(new)
    tasks = [task] if task is not None else drawn_tasks(places, seed=seed)
    tried = []
    for number, one in enumerate(tasks):
        try:
            tried.append(_reroute(planners, one))
        except InfeasibleError:
            if task is not None:
                raise
        if progress is not None:
            progress((number + 1) / len(tasks))
    if not tried:
        raise NoRouteError("no two of the places that the runs visited are joined by a route", tasks=len(tasks))
    shown = max(tried, key=lambda r: r.saving_share)
    turning = robots[0].turn_j_per_rad, robots[1].turn_j_per_rad
    prices = old.mean_energy_per_m(), new.mean_energy_per_m()
    return Comparison(shown, tuple(tried), task is not None, turning, new.frame, prices)


def _reroute(planners: tuple[RoutePlanner, RoutePlanner], task: Task) -> Rerouted:
    before = planners[0].plan(*task).route
    lattice = planners[1].lattice
    repriced = price_route(lattice, before.points)
    after = planners[1].plan(*task).route
    if after.energy_j > repriced.energy_j:  # the any-angle step is no exact search
        after = repriced
    along = [std_along(lattice, [route]) for route in (repriced, after)]
    old_j = price_route(planners[0].lattice, after.points).energy_j
    return Rerouted(task, before, repriced, after, old_j, (_last(along[0]), _last(along[1])))


def _last(std_j: FloatArray | None) -> float | None:
    return None if std_j is None else float(std_j[-1]) if std_j.size else 0.0


def drawn_tasks(places: FloatArray, *, seed: int) -> list[Task]:
    """Start and goal of the two places (n, 2) farthest apart, and of a few seeded pairs that are not much closer."""
    angle = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
    outermost = places[np.unique(np.argmax(places @ np.stack([np.cos(angle), np.sin(angle)]), axis=0))]
    apart = np.hypot(*(outermost[:, None] - outermost).transpose(2, 0, 1))
    a, b = np.unravel_index(int(np.argmax(apart)), apart.shape)
    pairs = [(outermost[a], outermost[b])]
    drawn = places[np.random.default_rng(seed).integers(0, len(places), (50 * _OTHERS, 2))]
    far = np.hypot(*(drawn[:, 0] - drawn[:, 1]).T) >= _LEAST_SHARE * apart[a, b]
    pairs += [(start, goal) for start, goal in drawn[far][:_OTHERS]]
    return [((float(s[0]), float(s[1])), (float(g[0]), float(g[1]))) for s, g in pairs]
