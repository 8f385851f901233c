"""Every search on one map beside SciPy's on the very same prices, and A*'s expansions beside Dijkstra's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.moves import MoveTable, move_table
from joulemap.planner.questions.replan import Replanner
from tests.bench.maps import CORNERS, free_corner, physics_lattice, terrain
from tests.bench.timing import Row, once, raced, seconds

TURN_J_PER_RAD = 50.0


def bench_searches(cells: int, resolution_m: float) -> list[Row]:
    """`search_rows` for 16 neighbours, from corner to corner."""
    lattice = physics_lattice(terrain(cells, resolution_m))
    ends = (free_corner(lattice, end) for end in CORNERS)
    return [(f"{cells} x {cells}", *row) for row in search_rows(lattice, 16, *ends)]


def scipy_graph(table: MoveTable) -> csr_array:
    """The move prices as SciPy wants them."""
    rows, cols, moves = table.energy.shape
    cell = np.arange(rows * cols).reshape(rows, cols)
    row_of, col_of, price = [], [], []
    for n in range(moves):
        r, c = np.nonzero(np.isfinite(table.energy[:, :, n]))
        row_of.append(cell[r, c])
        col_of.append(cell[r + table.offsets[n, 0], c + table.offsets[n, 1]])
        price.append(table.energy[r, c, n].astype(np.float64))
    size = rows * cols
    return csr_array((np.concatenate(price), (np.concatenate(row_of), np.concatenate(col_of))), shape=(size, size))


def search_rows(
    lattice: CostLattice, neighbours: int, start: np.ndarray, goal: np.ndarray
) -> list[tuple[str, float, str, float | None]]:
    """Every search on one move table beside SciPy's on the same prices; turning beside the field without."""
    table = move_table(lattice, neighbours=neighbours)
    name = f"{neighbours} neighbours"
    build = seconds(lambda: move_table(lattice, neighbours=neighbours))
    began = time.perf_counter()
    graph = scipy_graph(table)
    graph_build = time.perf_counter() - began
    source = int(start[0] * lattice.frame.cols + start[1])
    ours = field_from(lattice, table, start).energy_j
    assert np.allclose(ours, dijkstra(graph, indices=source).reshape(ours.shape), rtol=1e-9), "the two fields differ"
    rows: list[tuple[str, float, str, float | None]] = [
        (f"pricing the moves, {name}", build, "building SciPy's graph", build / graph_build)
    ]
    towards = field_towards(lattice, table, goal[None])
    rng = np.random.default_rng(2)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    pairs = free[rng.integers(len(free), size=(10, 2))]
    works: dict[str, Callable[[], object]] = {
        "scipy dijkstra, search alone": lambda: dijkstra(graph, indices=source),
        "energy field": lambda: field_from(lattice, table, start),
        "A* corner to corner": lambda: grid_search(lattice, table, start, goal),
        "10 A* between random places": lambda: [grid_search(lattice, table, *pair) for pair in pairs],
        "a further start to the same goal": lambda: towards.path_from(start),
    }
    peer, *mine = raced(works).items()
    rows.append((f"{peer[0]}, {name}", peer[1][0], "", None))
    rows += [(f"{stage}, {name}", took, peer[0], ratio) for stage, (took, ratio) in mine]
    expanded = [grid_search(lattice, table, start, goal, planner=name).expanded for name in ("dijkstra", "astar")]
    words = "states settled by Dijkstra {:,}, A* {:,}".format(*expanded)
    rows.append((f"{words}, {name}", np.nan, "", None))
    if neighbours == 16:
        turning = replace(lattice, robot=replace(lattice.robot, turn_j_per_rad=TURN_J_PER_RAD))
        turns = move_table(turning, neighbours=neighbours)
        _, (took, ratio) = raced(
            {"plain": works["energy field"], "turning": lambda: field_from(turning, turns, start)}, rounds=3
        ).values()
        rows.append((f"energy field with turns at {TURN_J_PER_RAD:g} J/rad, {name}", took, "the field without", ratio))
        replanner = Replanner(lattice, goal[None])
        blocks = lattice.blocked.copy()
        middle = tuple(slice(n // 2, n // 2 + 10) for n in blocks.shape)
        blocks[middle] = Blocked.STEP
        other = replace(lattice, blocked=blocks)
        window = (middle[0].start, middle[0].stop, middle[1].start, middle[1].stop)
        replanner.change(other, window=window)
        took = min(once(lambda k=k: replanner.change((lattice, other)[k % 2], window=window)) for k in range(4))
        rows.append(
            (
                f"a changed square of 10 x 10 cells, field repaired, {name}",
                took,
                "priced and searched anew",
                took / (build + mine[0][1][0]),
            )
        )
    return rows
