"""The same task planned before and after a calibration, and what the new route saves at the calibrated costs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InfeasibleError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route import Route, price_route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.analysis.route_uncertainty import quantiles_of_route
from joulemap.service.models import planning_robot
from joulemap.service.places.coordinates import PlaceLike
from joulemap.service.places.places import Places

FloatArray = NDArray[np.float64]
Point = tuple[float, float]
Task = tuple[Point, Point]
AskedTask = tuple[PlaceLike, PlaceLike]

_OTHERS = 5  # tasks that are tried where no route joins the farthest places
_LEAST_SHARE = 0.4  # of the greatest distance that lies between the ends of those
_FARTHEST = "the two places with the greatest distance that the runs visited"
_DIRECTIONS = 32
_CELLS = 250_000  # about as many has the lattice that routes are compared on


@dataclass(frozen=True, eq=False, repr=False)
class Rerouted:
    """One task, planned with both models.

    Attributes
    ----------
    task : tuple of tuple of float
        Start and goal [m].
    before : Route
        Planned with and priced by the base model.
    repriced : Route
        The same route, priced by the calibrated model.
    after : Route
        Planned with and priced by the calibrated model.
    old_j : float
        Energy of `after` by the base model [J].
    std_j : tuple of float
        Standard deviations of `repriced` and `after` [J], None where they are not known.
    """

    task: Task
    before: Route
    repriced: Route
    after: Route
    old_j: float
    std_j: tuple[float | None, float | None]

    @property
    def saving_j(self) -> float:
        """Energy that the new route saves compared with the old one, both by the calibrated model [J]."""
        return self.repriced.energy_j - self.after.energy_j

    @property
    def saving_share(self) -> float:
        """Saving as a share of the energy of the old route, 0..1."""
        return self.saving_j / self.repriced.energy_j if self.repriced.energy_j > 0 else 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What a calibration changes in plans and on the map.

    Attributes
    ----------
    shown : Rerouted
        The task that is reported.
    chosen : str
        How the task was chosen, in words.
    turn_j_per_rad : tuple of float
        What turning costs in plans, before and after [J/rad].
    frame : GridFrame
        Of the cells.
    price_per_m : tuple of ndarray, (rows, cols)
        Energy per metre of the cells, before and after [J/m], mean over the headings that may be driven; NaN where
        there are none.
    """

    shown: Rerouted
    chosen: str
    turn_j_per_rad: tuple[float, float]
    frame: GridFrame
    price_per_m: tuple[FloatArray, FloatArray]

    def map_as_dict(self) -> dict[str, Any]:
        """Return what a calibration changes on the map, JSON-able; 95 % of the cells change by `low` to `high`."""
        before, after = self.price_per_m
        low, high = (float(q) for q in np.nanquantile(after - before, [0.025, 0.975]))
        return {
            "mean_price_per_m": {"before": float(np.nanmean(before)), "after": float(np.nanmean(after))},
            "change_per_m": {"low": low, "high": high},
            "turn_j_per_rad": {"before": self.turn_j_per_rad[0], "after": self.turn_j_per_rad[1]},
        }

    def as_dict(self) -> dict[str, Any]:
        """Return the routes, JSON-able; energies are by the calibrated model unless the key says otherwise."""
        shown = self.shown
        return {
            "task": {"start": list(shown.task[0]), "goal": list(shown.task[1]), "chosen": self.chosen},
            "before": _route(shown.repriced, shown.std_j[0]) | {"energy_at_old_prices_j": shown.before.energy_j},
            "after": _route(shown.after, shown.std_j[1]) | {"energy_at_old_prices_j": shown.old_j},
            "saving_j": shown.saving_j,
            "saving_percent": 100.0 * shown.saving_share,
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
    task: AskedTask | None = None,
    seed: int = 0,
) -> Comparison:
    """Plan the same task with two models. `places` (n, 2): world points that the runs visited [m].

    Without a task it is the farthest one that has a route: one that is chosen by its saving would promise too much.
    """
    west, south, east, north = heightmap.frame.bounds
    spacing = max(1.0, math.ceil(math.sqrt((east - west) * (north - south) / _CELLS)))
    robots = planning_robot(before, robot, heightmap), planning_robot(after, robot, heightmap)
    new = build_lattice(heightmap, robots[1], after, spacing_m=spacing)
    # an effect may be unknown where the base model is not: both go where both know
    old = replace(build_lattice(heightmap, robots[0], before, spacing_m=spacing), blocked=new.blocked)
    planners = RoutePlanner(old), RoutePlanner(new)
    meant = Places(heightmap.frame)
    turning = robots[0].turn_j_per_rad, robots[1].turn_j_per_rad
    prices = old.mean_energy_per_m(), new.mean_energy_per_m()
    if task is not None:
        shown, chosen = _reroute(planners, (meant(task[0], "start"), meant(task[1], "goal"))), "as asked for"
        return Comparison(shown, chosen, turning, new.frame, prices)
    for number, one in enumerate(tasks := drawn_tasks(places, seed=seed)):
        try:
            shown = _reroute(planners, one)
        except InfeasibleError:
            continue
        chosen = "two places far from each other that the runs visited" if number else _FARTHEST
        return Comparison(shown, chosen, turning, new.frame, prices)
    raise NoRouteError("no route joins any two of the places that the runs visited", tasks=len(tasks))


def _reroute(planners: tuple[RoutePlanner, RoutePlanner], task: Task) -> Rerouted:
    before = planners[0].plan(*task).route
    lattice = planners[1].lattice
    repriced = price_route(lattice, before.points)
    after = planners[1].plan(*task).route
    if after.energy_j > repriced.energy_j:  # the any-angle step is no exact search
        after = repriced
    stds = tuple(quantiles_of_route(route)["energy_std_j"] for route in (repriced, after))
    old_j = price_route(planners[0].lattice, after.points).energy_j
    return Rerouted(task, before, repriced, after, old_j, (stds[0], stds[1]))


def drawn_tasks(places: FloatArray, *, seed: int) -> list[Task]:
    """Return tasks between places.

    `places` (n, 2): world points [m]. Result: start and goal: the two places with the greatest distance, and a few
    random pairs that are not much closer.
    """
    angle = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
    outermost = places[np.unique(np.argmax(places @ np.stack([np.cos(angle), np.sin(angle)]), axis=0))]
    distance = np.hypot(*(outermost[:, None] - outermost).transpose(2, 0, 1))
    a, b = np.unravel_index(int(np.argmax(distance)), distance.shape)
    pairs = [(outermost[a], outermost[b])]
    drawn = places[np.random.default_rng(seed).integers(0, len(places), (50 * _OTHERS, 2))]
    far = np.hypot(*(drawn[:, 0] - drawn[:, 1]).T) >= _LEAST_SHARE * distance[a, b]
    pairs += [(start, goal) for start, goal in drawn[far][:_OTHERS]]
    return [((float(s[0]), float(s[1])), (float(g[0]), float(g[1]))) for s, g in pairs]
