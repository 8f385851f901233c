"""Energies of the paths that planners find: our own and OMPL's over time on one map, everybody's corner to corner."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from rich.table import Table

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import JoulemapError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.synthesis import sample_terrain
from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.heuristics import guide_everywhere
from joulemap.planner.grid.search import grid_search
from joulemap.planner.grid.states import new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.pricing.integrator import leg_prices_between, path_price
from joulemap.planner.pricing.move_prices import move_offsets
from joulemap.planner.pricing.moves import MoveTable, move_table, table_of
from joulemap.planner.questions.bound import bound_table, energy_bound
from joulemap.planner.route_planner import SAMPLING_PLANNERS, RouteOptions, RoutePlanner
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
            "16 neighbours": planner.plan(start, goal, RouteOptions(refine=False)).route.energy_j,
            "shortest path": best.shortest.energy_j,
        }
        for name in SAMPLING_PLANNERS:
            history = sampled(planner, start, goal, name, LIMITS_S[-1])
            for limit in LIMITS_S:
                by_then = [energy for second, energy in history if second <= limit + 0.05]
                energies[f"{name}, {limit:g} s"] = min(by_then, default=np.nan)
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
) -> list[tuple[float, float]]:
    """(seconds, energy [J]) of a sampling planner's best way as it fell; empty where it found none."""
    try:
        found = planner.plan(start, goal, RouteOptions(planner=name, time_limit_s=limit_s, refine=False))
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
    took = seconds(lambda: grid_search(lattice, table, start, goal))
    found = grid_search(lattice, table, start, goal)
    rows.append(PeerRow("ours, A*, 16", took, energy_j=found.energy_j))
    grid = found.points
    took = seconds(lambda: improved(lattice, grid), repeats=1)
    best = path_price(lattice, improved(lattice, grid))
    rows.append(PeerRow("ours, any-angle after it", took, energy_j=best))
    ends = [tuple(float(v) for v in lattice.frame.xy(*end)) for end in (start, goal)]
    for name in ("rrtstar", "bitstar"):
        try:
            found = RoutePlanner(lattice).plan(*ends, RouteOptions(planner=name, time_limit_s=3.0, refine=False))
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


REFINED = 4
"""Nodes of the reference along the side of a cell."""
OPTIONS = ("alternatives", "32 neighbours", "BIT*")
"""What else of ours may be asked for a route."""
NOTICED = 0.001
"""Share of the energy that another option of ours may save."""


def compare_options(heightmap: Heightmap | None, tasks: int, sampling_s: float, seed: int, only: str = "") -> Table:
    """Random tasks on several maps: what other options of ours, a finer lattice and the bound say beside the default.

    heightmap : a real one, or None; sampling_s : time of BIT*, 0 to leave it out; seed : of the tasks;
    only : part of the names of the maps.
    """
    out = Table(title=f"energy of the default answer beside others, {tasks} random tasks a map")
    columns = ("map", "beside", "mean gap %", "95th percentile %", "worst %", "tasks above 0.1 %")
    for column in columns:
        out.add_column(column, justify="left" if column in columns[:2] else "right")
    asked = cheaper = 0
    for name, lattice in quality_maps(heightmap):
        if only not in name:
            continue
        gaps, below, seconds_each = _gaps(lattice, tasks, sampling_s, seed)
        asked += tasks
        cheaper += int((np.array([gaps[option] for option in OPTIONS if option in gaps]) > NOTICED).any(axis=0).sum())
        for beside, values in gaps.items():
            share = 100.0 * np.array(values)
            out.add_row(
                name,
                beside,
                f"{share.mean():.3f}",
                f"{np.percentile(share, 95):.3f}",
                f"{share.max():.3f}",
                str(int((share > 100.0 * NOTICED).sum())),
            )
        out.add_row(name, f"bound above the reference: {below} tasks; {seconds_each:.3f} s an answer", "", "", "", "")
    out.caption = f"tasks where an option of ours is more than 0.1 % cheaper than the default: {cheaper} of {asked}"
    return out


def quality_maps(heightmap: Heightmap | None) -> Iterator[tuple[str, CostLattice]]:
    if heightmap is not None:
        for model in ("default", "physics"):
            yield f"heightmap, {model}", build_lattice(heightmap, Robot(), load_predictor(model))
    yield "sample terrain, default", build_lattice(sample_terrain(), Robot(), load_predictor("default"))
    yield "generated, 200 m, physics", physics_lattice(terrain(200, 0.5))
    yield "generated, 120 m, physics", physics_lattice(terrain(120, 0.5))


def _gaps(lattice: CostLattice, tasks: int, sampling_s: float, seed: int) -> tuple[dict[str, list[float]], int, float]:
    """Shares by which the default answer costs more than others; tasks whose bound exceeds the reference; seconds."""
    planner, fine, prices = RoutePlanner(lattice), refined_moves(lattice), bound_table(lattice)
    planner.prepare()
    free = np.argwhere(lattice.blocked == 0).astype(float)
    rng = np.random.default_rng(seed)
    names = (*OPTIONS, f"lattice refined {REFINED} times, 32 neighbours", "bound")
    gaps: dict[str, list[float]] = {name: [] for name in names}
    above, spent, done = 0, 0.0, 0
    while done < tasks:
        start, goal = free[rng.integers(len(free), size=2)]
        ends = [tuple(float(v) for v in lattice.frame.xy(*end)) for end in (start, goal)]
        if np.abs(start - goal).max() < 5.0:
            continue
        began = time.perf_counter()
        try:
            best = planner.plan(*ends)
        except JoulemapError:
            continue
        spent += time.perf_counter() - began
        done += 1
        energy = best.route.energy_j
        others = planner.plan(*ends, RouteOptions(alternatives=3))
        found = {
            names[0]: others.route.energy_j,
            names[1]: planner.plan(*ends, RouteOptions(neighbours=32)).route.energy_j,
        }
        if sampling_s > 0.0:
            found[names[2]] = planner.plan(
                *ends, RouteOptions(planner="bitstar", time_limit_s=sampling_s)
            ).route.energy_j
        found[names[3]] = reference_energy(fine, start, goal)
        if prices is not None:
            found["bound"] = energy_bound(lattice, prices, start, goal)
            above += found["bound"] > found[names[3]] * (1.0 + 1e-6)
        for name, other in found.items():
            gaps[name].append(energy / other - 1.0)
    return {name: values for name, values in gaps.items() if values}, above, spent / tasks


def refined_moves(lattice: CostLattice) -> MoveTable:
    """32 moves between the nodes of a lattice that is `REFINED` times as fine, priced by the same integrator."""
    offsets = move_offsets(32)
    rows, cols = ((n - 1) * REFINED + 1 for n in lattice.frame.shape)
    energy = np.full((rows, cols, len(offsets)), np.nan, dtype=np.float32)

    def _row(i: int) -> None:
        for n, (down, right) in enumerate(offsets.tolist()):
            j = np.arange(max(0, -right), cols - max(0, right))
            if 0 <= i + down < rows:
                here = np.column_stack([np.full(j.size, i), j]) / REFINED
                energy[i, j, n] = leg_prices_between(lattice, here, here + np.array([down, right]) / REFINED)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(_row, range(rows)))
    flat = np.zeros((rows, cols))
    return table_of(energy, offsets, flat, spacing_m=lattice.frame.resolution_m / REFINED)


def reference_energy(fine: MoveTable, start: np.ndarray, goal: np.ndarray) -> float:
    """Least energy [J] between two cell centres over the moves of `refined_moves`."""
    first, last = (
        np.array([int(end[0] * REFINED) * fine.energy.shape[1] + int(end[1] * REFINED)]) for end in (start, goal)
    )
    guide = guide_everywhere(fine, backward=False)
    search = new_search(fine, 1, first, np.zeros((1, 1)), backward=False)
    return run_search(search, fine, first, guide, last, np.zeros((1, 1)))[1]
