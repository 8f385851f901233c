"""`make bench`: seconds per stage on 200 x 200 and 1000 x 1000 cells, each beside its peer in the same run.

Times are the least of several repeats after a warm-up, kernels compiled. SciPy gets the very same move prices.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from fastapi.testclient import TestClient
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from model.energy.predictor import load_predictor
from model.energy.resnet import ResNetEnergy
from model.errors import NoRouteError
from model.frames import GridFrame
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from model.terrain.patches import cut_patches
from model.terrain.readers import read_heightmap
from model.terrain.synthesis import TerrainRecipe, make_terrain
from model.terrain.writers import write_geotiff
from planner.edges import path_price
from planner.fields import field_from, field_towards
from planner.landmarks import make_landmarks
from planner.lattice import Blocked, CostLattice
from planner.lattice_build import build_lattice
from planner.moves import MoveTable, move_table
from planner.plan import RoutePlanner
from planner.refine import refine_path
from planner.replan import Replanner
from planner.search import grid_search
from service.app import create_app
from service.settings import Settings
from tests.bench.peers import PeerRow, Question, ask_peers

ROBOT = Robot()
SIZES = (200, 1000)
RESNET_PATCHES = 16
TURN_J_PER_RAD = 50.0


def seconds(work: Callable[[], object], *, repeats: int = 3) -> float:
    """Least wall time of `repeats` calls, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def raced(works: dict[str, Callable[[], object]], *, rounds: int = 5) -> dict[str, tuple[float, float]]:
    """(least seconds, median ratio to the first of them) of each, taken by turns: a busy machine slows all alike."""
    for work in works.values():
        work()
    times = np.array([[_once(work) for work in works.values()] for _ in range(rounds)])
    ratios = np.median(times / times[:, :1], axis=0)
    return dict(zip(works, zip(times.min(axis=0).tolist(), ratios.tolist(), strict=True), strict=True))


def _once(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def terrain(cells: int, resolution_m: float) -> Heightmap:
    """Hills of up to 20 degrees, `cells` metres wide."""
    side = round(cells / resolution_m)
    frame = GridFrame(0.0, float(cells), resolution_m, side, side)
    recipe = TerrainRecipe(max_slope_deg=20.0, relief_longest_m=cells / 4, relief_shortest_m=cells / 40)
    return make_terrain(recipe, frame, np.random.default_rng(5))


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


def free_corner(lattice: CostLattice, near: tuple[float, float]) -> np.ndarray:
    """The free cell nearest to a point given as shares of rows and columns."""
    free = np.argwhere(lattice.blocked == 0)
    target = np.array(near) * lattice.frame.shape
    return free[np.argmin(((free - target) ** 2).sum(axis=1))].astype(float)


def request_seconds(heightmap: Heightmap, start: list[float], goal: list[float], model: str) -> dict[str, float]:
    """Seconds of the three requests of the main job, through the whole application in this process."""
    body = write_geotiff(None, heightmap)
    out: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder, TestClient(create_app(Settings(data_dir=Path(folder)))) as client:
        while client.get("/readyz").status_code != 200:
            time.sleep(0.1)
        began = time.perf_counter()
        uploaded = client.post("/v1/heightmaps", content=body, headers={"Content-Type": "image/tiff"}).json()
        out["upload"] = time.perf_counter() - began
        began = time.perf_counter()
        made = client.post(
            "/v1/costmaps", json={"heightmap_id": uploaded["id"], "model": model}, headers={"Prefer": "wait=300"}
        ).json()
        assert made["status"] == "done", made
        out["cost map"] = time.perf_counter() - began
        url = f"/v1/costmaps/{made['id']}/paths"
        for name in ("first path", "second path"):
            began = time.perf_counter()
            answer = client.post(url, json={"start": start, "goal": goal})
            assert answer.status_code == 200, answer.text
            out[name] = time.perf_counter() - began
    return out


def bench(cells: int, resolution_m: float) -> list[tuple[str, str, float, str, float | None]]:
    """Rows of (size, stage, seconds, what it is set beside, ratio ours / theirs)."""
    size = f"{cells} x {cells}"
    rows: list[tuple[str, str, float, str, float | None]] = []
    heightmap = terrain(cells, resolution_m)

    lattice = build_lattice(heightmap, ROBOT, load_predictor("physics"))
    took = seconds(lambda: build_lattice(heightmap, ROBOT, load_predictor("physics")))
    rows.append((size, "lattice, physics, 16 headings", took, "", None))
    default = load_predictor("default")
    network = seconds(lambda: build_lattice(heightmap, ROBOT, default), repeats=1)
    per_patch = resnet_seconds_per_patch(heightmap)
    rows.append((size, "lattice, default network, 16 headings", network, "ResNet18, a 256 x 256 patch per value",
                 network / (per_patch * cells * cells * 16)))  # fmt: skip
    n = 10_000
    rng = np.random.default_rng(0)
    x, y = rng.uniform(2, cells - 2, (2, n))
    heading = rng.uniform(0, 2 * np.pi, n)
    for side in (32, 256):
        count = n if side == 32 else 500
        cut = seconds(lambda: cut_patches(heightmap, x[:count], y[:count], heading[:count], size=side))  # noqa: B023
        rows.append((size, f"{count} patches of {side} x {side}", cut, "", None))
    rows.append((size, f"ResNet18 on {RESNET_PATCHES} patches of 256 x 256", per_patch * RESNET_PATCHES, "", None))

    start, goal = free_corner(lattice, (0.9, 0.1)), free_corner(lattice, (0.1, 0.9))
    for neighbours in (8, 16, 32):
        rows += [(size, *row) for row in search_rows(lattice, neighbours, start, goal)]
    path = grid_search(lattice, move_table(lattice), start, goal).points
    rows.append((size, "any-angle improvement", seconds(lambda: refine_path(lattice, path)), "", None))
    planner = RoutePlanner(lattice)
    ends = [tuple(float(v) for v in lattice.frame.xy(*p)) for p in (start, goal)]
    rows.append((size, "a whole plan, moves priced before", seconds(lambda: planner.plan(*ends)), "", None))
    for stage, took in request_seconds(heightmap, list(ends[0]), list(ends[1]), "default").items():
        rows.append((size, f"over HTTP: {stage}", took, "", None))
    return rows


def bench_searches(cells: int, resolution_m: float) -> list[tuple[str, str, float, str, float | None]]:
    """The searches of `bench` alone, 16 neighbours."""
    lattice = build_lattice(terrain(cells, resolution_m), ROBOT, load_predictor("physics"))
    ends = (free_corner(lattice, end) for end in ((0.9, 0.1), (0.1, 0.9)))
    return [(f"{cells} x {cells}", *row) for row in search_rows(lattice, 16, *ends)]


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
    landmarks = make_landmarks(table)
    rng = np.random.default_rng(2)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    pairs = free[rng.integers(len(free), size=(10, 2))]
    works: dict[str, Callable[[], object]] = {
        "scipy dijkstra, search alone": lambda: dijkstra(graph, indices=source),
        "energy field": lambda: field_from(lattice, table, start),
        "A* corner to corner": lambda: grid_search(lattice, table, start, goal),
        "A* with landmarks, corner to corner": lambda: grid_search(lattice, table, start, goal, landmarks=landmarks),
        "10 A* between random places": lambda: [grid_search(lattice, table, *pair) for pair in pairs],
        "10 A* with landmarks, random places": lambda: [
            grid_search(lattice, table, *pair, landmarks=landmarks) for pair in pairs
        ],
        "a further start to the same goal": lambda: towards.path_from(start),
    }
    peer, *mine = raced(works).items()
    rows.append((f"{peer[0]}, {name}", peer[1][0], "", None))
    rows += [(f"{stage}, {name}", took, peer[0], ratio) for stage, (took, ratio) in mine]
    rows.append(
        (f"making 4 landmarks, once per map, {name}", seconds(lambda: make_landmarks(table), repeats=1), "", None)
    )
    expanded = [
        grid_search(lattice, table, start, goal, planner=planner, landmarks=marks).expanded
        for planner, marks in (("dijkstra", None), ("astar", None), ("astar", landmarks))
    ]
    words = "states settled by Dijkstra {:,}, A* {:,}, A* with landmarks {:,}".format(*expanded)
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
        took = min(_once(lambda k=k: replanner.change((lattice, other)[k % 2], window=window)) for k in range(4))
        rows.append((f"a changed square of 10 x 10 cells, field repaired, {name}", took, "priced and searched anew",
                     took / (build + mine[0][1][0])))  # fmt: skip
    return rows


def resnet_seconds_per_patch(heightmap: Heightmap) -> float:
    """Seconds the paper's network takes for one 256 x 256 patch, in batches, on this machine."""
    torch.manual_seed(0)
    network = ResNetEnergy().eval()
    middle = heightmap.frame.resolution_m * heightmap.frame.cols / 2
    patches = torch.from_numpy(
        cut_patches(heightmap, *np.full((2, RESNET_PATCHES), middle), np.linspace(0, 6, RESNET_PATCHES), size=256)
    )
    with torch.inference_mode():
        return seconds(lambda: network(patches), repeats=2) / RESNET_PATCHES


CROSSINGS = (((0.10, 0.10), (0.90, 0.90)), ((0.92, 0.50), (0.05, 0.45)), ((0.70, 0.15), (0.40, 0.85)))
"""Start and goal as shares of rows and columns."""


def compare_planners(heightmap: Heightmap) -> Table:
    """Energies of what each planner finds on one map, `physics` prices, over that of the any-angle route."""
    lattice = build_lattice(heightmap, ROBOT, load_predictor("physics"))
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
        for name in ("rrtstar", "informed_rrtstar", "bitstar"):
            for words, options in (("", {}), (", from the grid", {"from_grid": True})):
                try:
                    found = planner.plan(start, goal, planner=name, time_limit_s=10.0, refine=False, **options)
                    history = found.details.get("history", [])
                except NoRouteError:
                    history = []
                for limit in (1.0, 3.0, 10.0):
                    by_then = [energy for second, energy in history if second <= limit + 0.05]
                    energies[f"{name}{words}, {limit:g} s"] = min(by_then, default=np.nan)
        finished = planner.plan(start, goal, planner="bitstar", time_limit_s=3.0, from_grid=True)
        energies["bitstar, from the grid, 3 s, any-angle after it"] = finished.route.energy_j
        columns.append(energies)
        table.add_column(f"crossing {k + 1}, {best.route.length_m:.0f} m", justify="right")
    for name in columns[0]:
        table.add_row(name, *(f"{c[name] / c['any-angle route']:.3f}" for c in columns))
    return table


def compare_peers(cells: int, resolution_m: float) -> Table:
    """Everybody's search from corner to corner on one map, with the energy of the path under our integrator."""
    lattice = build_lattice(terrain(cells, resolution_m), ROBOT, load_predictor("physics"))
    table = move_table(lattice)
    start, goal = (free_corner(lattice, end) for end in ((0.9, 0.1), (0.1, 0.9)))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resolution", type=float, default=0.25, help="metres per pixel of the heightmaps")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="cells along a side, 1 m each")
    parser.add_argument("--json", type=Path, help="also write the rows here")
    parser.add_argument("--heightmap", type=Path, help="compare the planners' energies on this map instead")
    parser.add_argument("--peers", action="store_true", help="set other people's searches beside ours instead")
    parser.add_argument("--searches", action="store_true", help="only the searches")
    options = parser.parse_args()
    if options.peers:
        for cells in options.sizes:
            Console(width=140).print(compare_peers(cells, options.resolution))
        return
    if options.heightmap:
        Console(width=140).print(compare_planners(read_heightmap(options.heightmap)))
        return
    machine = (
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    measure = bench_searches if options.searches else bench
    rows = [row for cells in options.sizes for row in measure(cells, options.resolution)]
    table = Table(title=f"joulemap bench, {dt.date.today()}, {machine}, heightmap {options.resolution:g} m per pixel")
    for name in ("cells", "stage", "seconds", "beside", "ours / theirs"):
        table.add_column(name, justify="right" if name in ("seconds", "ours / theirs") else "left")
    for size, stage, took, peer, ratio in rows:
        table.add_row(
            size, stage, "" if np.isnan(took) else f"{took:.4f}", peer, "" if ratio is None else f"{ratio:.3g}"
        )
    Console(width=140).print(table)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
