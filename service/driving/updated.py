"""A cost map with what a drive has taught, and whether another way has become better."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from joulemap.model import ranges
from joulemap.model.errors import NoRouteError
from joulemap.model.frames import heading_bins, heading_vector
from joulemap.model.loop.drive_filter import DriveFilter
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.driving.ahead import metres_of
from joulemap.service.exports.clearance import price_given_path

_SURE_STEPS = 1.6449  # of a normal distribution: 95 % of one side


@dataclass(frozen=True, eq=False)
class BetterRoute:
    """Another way that has become cheaper by more than its uncertainty.

    Attributes
    ----------
    route : Route
        From where the robot is to the goal, at what driving costs in this run.
    saving_j, saving_std_j : float
        What it saves of the rest of the present route, and how uncertain that is [J].
    """

    route: Route
    saving_j: float
    saving_std_j: float

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-able."""
        savings = {"saving_j": self.saving_j, "saving_std_j": self.saving_std_j}
        sizes = {"length_m": self.route.length_m, "energy_j": self.route.energy_j}
        return {"path": self.route.points[:, :2].tolist(), **sizes, **savings}


def updated_lattice(lattice: CostLattice, known: DriveFilter) -> CostLattice:
    """Return the lattice at what driving costs in this run: every cause is part of the traction, of the cost of turning
    or of the power at rest, so that nothing is predicted anew.

    What still differs between runs is then the uncertainty of the causes, as a share of the mean energy.
    """
    level, ground, slope, power = known.mean[:4].tolist()
    robot, traction = lattice.robot, lattice.traction_per_m
    east, north = heading_vector(heading_bins(lattice.headings))
    rise = lattice.gradient[..., :1] * east.astype(np.float32) + lattice.gradient[..., 1:] * north.astype(np.float32)
    beyond = np.float32(robot.weight_n) * (np.float32(ground * robot.rolling_resistance) + np.float32(slope) * rise)
    changed = np.where(traction > 0.0, np.float32(1.0 + level) * traction + beyond, traction)
    idle = ranges.ROBOT["idle_power_w"]
    robot = replace(
        robot,
        idle_power_w=float(np.clip(robot.idle_power_w * (1.0 + level + power), idle.low, idle.high)),
        turn_j_per_rad=max((1.0 + level) * robot.turn_j_per_rad, 0.0),
    )
    model = dict(lattice.provenance.get("model", {}))
    if model.get("spread") is not None:
        share = math.sqrt(max(float(known.covariance[0, 0]), 0.0))
        model["spread"] = {**model["spread"], "run_share": share, "run_std_share": 0.0, "bias": 0.0}
    provenance = {**lattice.provenance, "model": model}
    return replace(lattice, robot=robot, traction_per_m=changed.astype(np.float32), provenance=provenance)


def better_route(lattice: CostLattice, known: DriveFilter, rest: Route) -> BetterRoute | None:
    """Return another way from here to the goal that is cheaper by more than its uncertainty, or None.

    `lattice`: as planned; `rest`: the rest of the present route.
    """
    updated = updated_lattice(lattice, known)
    here, goal = ((float(x), float(y)) for x, y in rest.points[[0, -1], :2])
    try:
        found = RoutePlanner(updated).plan(here, goal).route
    except NoRouteError:
        return None
    ways = [price_given_path(updated, way.points[:, :2]) for way in (rest, found)]
    saving = ways[0].energy_j - ways[1].energy_j
    then, now = (metres_of(lattice, price_given_path(lattice, way.points[:, :2])).sums[-1] for way in (found, rest))
    of = now[:-2] - then[:-2]
    variance = float(of @ known.covariance[:-1, :-1] @ of) + known.prior.noise**2 * float(now[-2] + then[-2])
    std = known.prior.width * math.sqrt(max(variance, 0.0))
    return BetterRoute(found, float(saving), std) if saving > _SURE_STEPS * std else None
