"""Energies of the paths that planners find: our own and OMPL's over time on one map, everybody's corner to corner."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from rich.table import Table

from joulemap.model.errors import NoRouteError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.edges import path_price
from joulemap.planner.landmarks import make_landmarks
from joulemap.planner.moves import move_table
from joulemap.planner.plan import SAMPLING_PLANNERS, RoutePlanner
from joulemap.planner.refine import refine_path
from joulemap.planner.search import grid_search
from tests.bench.maps import CORNERS, free_corner, physics_lattice, terrain
from tests.bench.peers import PeerRow, Question, ask_peers
from tests.bench.searches import scipy_graph
from tests.bench.timing import seconds

CROSSINGS = (((0.10, 0.10), (0.90, 0.90)), ((0.92, 0.50), (0.05, 0.45)), ((0.70, 0.15), (0.40, 0.85)))
"""Start and goal as shares of rows and columns."""
LIMITS_S = (1.0, 3.0, 10.0)
"""When the sampling planners' gap is looked at."""


def compare_planners(heightmap: Heightmap) -> Table:
    """Energies of what each planner finds on one map, `physics` prices, over that of the any-angle route."""
    lattice = physics_lattice(heightmap)
    planner = RoutePlanner(lattice)
    table = Table(title=f"energy over the any-angle route's, {heightmap.source}")
    table.add_column("found by")
    columns = []
    for k, ends in enumerate(CROSSINGS):
        start, goal = (tuple(float(v) for v in lattice.frame.xy(*free_corner(lattice, end))) for end in ends)
        best = planner.plan(start, goal)
        energies = {
            "any-angle route": best.route.energy_j,
            "16 neighbours": best.details["grid_energy_j"],
            "shortest path": best.shortest.energy_j,
        }
        for name in SAMPLING_PLANNERS:
            for words, from_grid in (("", False), (", from the grid", True)):
                staged = name == "bitstar" and from_grid  # its corridors narrow with the time it has
                for limits in [(limit,) for limit in LIMITS_S] if staged else [LIMITS_S]:
                    history = sampled(planner, start, goal, name, limits[-1], from_grid=from_grid)
                    for limit in limits:
                        by_then = [energy for second, energy in history if second <= limit + 0.05]
                        energies[f"{name}{words}, {limit:g} s"] = min(by_then, default=np.nan)
        finished = planner.plan(start, goal, planner="bitstar", time_limit_s=3.0, from_grid=True)
        energies["bitstar, from the grid, 3 s, any-angle after it"] = finished.route.energy_j
        columns.append(energies)
        table.add_column(f"crossing {k + 1}, {best.route.length_m:.0f} m", justify="right")
    for name in columns[0]:
        table.add_row(name, *(f"{c[name] / c['any-angle route']:.3f}" for c in columns))
    return table


def sampled(
    planner: RoutePlanner,
    start: tuple[float, float],
    goal: tuple[float, float],
    name: str,
    limit_s: float,
    *,
    from_grid: bool,
) -> list[tuple[float, float]]:
    """(seconds, energy [J]) of a sampling planner's best way as it fell; empty where it found none."""
    try:
        found = planner.plan(start, goal, planner=name, time_limit_s=limit_s, refine=False, from_grid=from_grid)
    except NoRouteError:
        return []
    return found.details.get("history", [])


def compare_peers(cells: int, resolution_m: float) -> Table:
    """Everybody's search from corner to corner on one map, with the energy of the path under our integrator."""
    lattice = physics_lattice(terrain(cells, resolution_m))
    table = move_table(lattice)
    start, goal = (free_corner(lattice, end) for end in CORNERS)
    began = time.perf_counter()
    graph = scipy_graph(table)
    build = time.perf_counter() - began
    rows = ask_peers(Question(lattice, table, graph, *(tuple(int(v) for v in end) for end in (start, goal))))
    rows[0] = replace(rows[0], build_s=build)
    landmarks = make_landmarks(table)
    for name, options in (("ours, A*, 16", {}), ("ours, A* with landmarks, 16", {"landmarks": landmarks})):
        took = seconds(lambda: grid_search(lattice, table, start, goal, **options))  # noqa: B023
        rows.append(PeerRow(name, took, energy_j=grid_search(lattice, table, start, goal, **options).energy_j))
    grid = grid_search(lattice, table, start, goal, landmarks=landmarks).points
    took = seconds(lambda: refine_path(lattice, grid), repeats=1)
    best = path_price(lattice, refine_path(lattice, grid))
    rows.append(PeerRow("ours, any-angle after it", took, energy_j=best))
    ends = [tuple(float(v) for v in lattice.frame.xy(*end)) for end in (start, goal)]
    for name in ("rrtstar", "bitstar"):
        try:
            found = RoutePlanner(lattice).plan(*ends, planner=name, time_limit_s=3.0, refine=False)
            rows.append(PeerRow(f"OMPL {name}, 3 s", 3.0, energy_j=found.details["sampled_energy_j"]))
        except NoRouteError:
            rows.append(PeerRow(f"OMPL {name}, 3 s", 3.0, note="no route in that time"))
    out = Table(title=f"peers, {cells} x {cells} cells, physics, corner to corner")
    for column in ("search by", "seconds", "building before it", "energy / any-angle", ""):
        out.add_column(column, justify="left" if column in ("search by", "") else "right")
    for row in rows:
        figures = (row.search_s, row.build_s, row.energy_j / best)
        out.add_row(row.name, *("" if np.isnan(f) else f"{f:.4g}" for f in figures), row.note)
    return out
