"""Does a robot's outline ever meet a wall, and are passages found that it fits through?

python -m tests.bench.outline [--tasks N] [--doors N] [--seed N]

Every pose of every route is judged by a rectangle on a raster of one centimetre (`tests.reference.outline`). A door is
at a random angle; it is wider than the outline and its clearance by one to three cells of the lattice and the rim of
its pixels, or narrower by the rim.
"""

from __future__ import annotations

import argparse
import math
from contextlib import suppress

import numpy as np
from rich.console import Console
from rich.table import Table

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.reference.outline import ROBOTS, first_collision, wall_with_door, world_with_walls

TASKS_A_WORLD = 20


def collisions(robot: Robot, cells_m: float, spacing_m: float, tasks: int, rng: np.random.Generator) -> tuple[int, int]:
    """Routes, the shortest ones among them, and how many of them meet a wall; a new world every `TASKS_A_WORLD`."""
    routes = met = 0
    for task in range(tasks):
        if task % TASKS_A_WORLD == 0:
            wall, heightmap = world_with_walls(rng, robot, cells_m=cells_m, spacing_m=spacing_m)
            planner = RoutePlanner(build_lattice(heightmap, robot, PhysicsPredictor(), spacing_m=spacing_m))
        start, goal = rng.uniform(0.05, 0.95, (2, 2)) * heightmap.frame.bounds[2]
        with suppress(NoRouteError, BlockedError):
            plan = planner.plan(tuple(start), tuple(goal), RouteOptions(snap=True))
            for route in (plan.route, plan.shortest):
                routes += 1
                met += first_collision(route.points[:, :2], robot, wall, heightmap.frame) is not None
    return routes, met


def doors_found(robot: Robot, cells_m: float, spacing_m: float, doors: int, rng: np.random.Generator) -> list[int]:
    """How many of the wide doors, and of the narrow ones, a route goes through."""
    needed_m, side_m = robot.width_m + 2.0 * robot.clearance_m, 16.0 * max(robot.width_m, 0.5 * robot.length_m)
    found = [0, 0]
    for _ in range(doors):
        angle_deg = rng.uniform(0.0, 90.0)
        angle = math.radians(angle_deg)
        rim_m = cells_m * (math.cos(angle) + math.sin(angle))
        for k, width_m in enumerate((needed_m + rng.uniform(1.0, 3.0) * spacing_m + rim_m, needed_m - rim_m)):
            hall = wall_with_door(width_m, angle_deg, cells_m=cells_m, side_m=side_m, thick_m=4.0 * cells_m)
            planner = RoutePlanner(build_lattice(hall, robot, PhysicsPredictor(), spacing_m=spacing_m))
            away = 0.3 * side_m * np.array([math.cos(angle), -math.sin(angle)])
            with suppress(NoRouteError):
                planner.plan(tuple(0.5 * side_m - away), tuple(0.5 * side_m + away))
                found[k] += 1
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=200, help="of each robot")
    parser.add_argument("--doors", type=int, default=40, help="wide ones of each robot, and as many narrow ones")
    parser.add_argument("--seed", type=int, default=56)
    options = parser.parse_args()
    table = Table(title=f"{options.tasks} tasks and {options.doors} doors a robot, seed {options.seed}")
    for name in ("width x length", "clearance", "routes", "meet a wall", "wide doors found", "narrow doors found"):
        table.add_column(name, justify="right")
    for number, (robot, *cells) in enumerate(ROBOTS):
        rng = np.random.default_rng([options.seed, number])
        routes, met = collisions(robot, *cells, options.tasks, rng)
        wide, narrow = doors_found(robot, *cells, options.doors, rng)
        shape = f"{robot.width_m:g} x {robot.length_m:g} m"
        table.add_row(shape, f"{robot.clearance_m:g} m", str(routes), str(met), f"{wide}", f"{narrow}")
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
