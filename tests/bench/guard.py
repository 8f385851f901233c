"""Stored answers of the planner, and how the present code's energies compare with them.

python -m tests.bench.guard [--map NAME] [--tasks N] --real HEIGHTMAP    compares; without --real, what needs none
python -m tests.bench.guard --write --tasks 200 --real HEIGHTMAP         stores today's answers instead

Stored are start, goal, energy of the answer, energy of the grid path and the route of random tasks, with the seed, day
and commit that made them. They say what the planner reached once, not what is best.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import subprocess
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.distance import cdist

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.synthesis import sample_terrain
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.pricing.polylines import subdivided
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.service.library.heightmaps import read_heightmap
from tests.bench.maps import terrain

STORED = Path(__file__).parent / "stored_answers.npz"
SEED = 51
LEAST_CELLS = 5
"""Least distance between start and goal, in rows or in columns."""
ROUTE_POINTS = 33
"""Points of a stored route, evenly spaced along it and rounded to a hundredth of a cell."""
OTHER_WAY_CELLS = 3.0
"""A route goes another way than the stored one if a point of that one is farther from it than this."""
SAME_PRICES = 1e-5
"""Relative difference of the sums over a map's moves above which its prices are not those of the stored answers."""


@dataclass(frozen=True)
class Case:
    """A map with a robot and a model.

    heightmap : None for the real one; open_ground : whether nothing but the ground's price decides there.
    """

    name: str
    model: str
    heightmap: Callable[[], Heightmap] | None
    robot: dict[str, float] = field(default_factory=dict)
    open_ground: bool = False


CASES = (
    Case("hillside, default", "default", None),
    Case("hillside, physics", "physics", None),
    Case("sample terrain, default", "default", sample_terrain, open_ground=True),
    Case("generated 120 m, physics", "physics", lambda: terrain(120, 0.5), open_ground=True),
    Case("generated 200 m, physics", "physics", lambda: terrain(200, 0.5), open_ground=True),
    Case("hillside, turning", "physics", None, {"turn_j_per_rad": 20.0}),
    Case("hillside, regeneration", "physics", None, {"regeneration": 0.4}),
    Case("hillside, limits", "physics", None, {"max_grade_deg": 15.0, "max_cross_slope_deg": 12.0}),
    Case("generated 120 m, turning", "physics", lambda: terrain(120, 0.5), {"turn_j_per_rad": 20.0}),
    Case("generated 120 m, regeneration", "physics", lambda: terrain(120, 0.5), {"regeneration": 0.4}),
    Case(
        "generated 200 m, limits",
        "physics",
        lambda: terrain(200, 0.5),
        {"max_grade_deg": 12.0, "max_cross_slope_deg": 12.0},
    ),
)


@dataclass(frozen=True, eq=False)
class Answers:
    """Of n tasks on one map. ends : (n, 4) cells, row and column of start and goal; route_cells : (n, points, 2)."""

    ends: NDArray[np.int16]
    energy_j: NDArray[np.float64]
    grid_j: NDArray[np.float64]
    cpu_ms: NDArray[np.float64]
    route_cells: NDArray[np.float64]


def lattice_of(case: Case, real: Heightmap | None) -> CostLattice:
    heightmap = real if case.heightmap is None else case.heightmap()
    assert heightmap is not None, f"{case.name} needs the real heightmap: --real"
    robot = Robot(**case.robot, tracking_std_m=0.0)  # without margin and averaging, as when the answers were stored
    heightmap = replace(heightmap, given_noise_m=0.0)  # the moves of the stored answers
    return build_lattice(heightmap, robot, load_predictor(case.model))


def price_sums(lattice: CostLattice) -> list[float]:
    """A fingerprint of a lattice's prices: the number of open moves, and two weighted sums of their energies [J]."""
    energy = move_table(lattice, neighbours=16).energy.astype(np.float64).ravel()
    known = np.flatnonzero(np.isfinite(energy))
    values = energy[known]
    return [float(known.size), float(values.sum()), float(values @ (1.0 + np.cos(known.astype(np.float64))))]


def random_ends(lattice: CostLattice, tasks: int, seed: int) -> NDArray[np.int16]:
    """(tasks, 4) places between which the grid has a way."""
    free = np.argwhere(lattice.blocked == 0)
    rng, planner = np.random.default_rng(seed), RoutePlanner(lattice)
    out: list[NDArray[np.int16]] = []
    while len(out) < tasks:
        start, goal = free[rng.integers(len(free), size=2)]
        if np.abs(start - goal).max() < LEAST_CELLS:
            continue
        try:
            planner.plan(*(lattice.frame.xy(*end) for end in (start, goal)), RouteOptions(refine=False))
        except (BlockedError, NoRouteError):  # grade and cross slope may close every heading of a cell
            continue
        out.append(np.concatenate([start, goal]).astype(np.int16))
    return np.array(out)


def answers(lattice: CostLattice, ends: NDArray[np.int16]) -> Answers:
    """What the present code says of some tasks."""
    planner = RoutePlanner(lattice)
    energy, grid, spent, routes = [], [], [], []
    for k in [0, *range(len(ends))]:  # once more for what is compiled or loaded at the first question
        start, goal = ([float(v) for v in lattice.frame.xy(*end)] for end in (ends[k, :2], ends[k, 2:]))
        began = time.process_time()
        plan = planner.plan(tuple(start), tuple(goal))
        spent.append(1e3 * (time.process_time() - began))
        energy.append(plan.route.energy_j)
        grid.append(plan.details["grid_energy_j"])
        routes.append(_thinned(np.column_stack(lattice.frame.rowcol(*plan.route.points[:, :2].T))))
    return Answers(ends, *(np.array(values[1:]) for values in (energy, grid, spent, routes)))


def _thinned(points: NDArray[np.float64]) -> NDArray[np.float64]:
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    at = np.linspace(0.0, along[-1], ROUTE_POINTS)
    return np.column_stack([np.interp(at, along, points[:, axis]) for axis in range(2)])


def store(case: Case, lattice: CostLattice, found: Answers, commit: str) -> None:
    """Put the answers of one map in the file; those of others stay."""
    kept = dict(np.load(STORED)) if STORED.exists() else {}
    about = {"seed": SEED, "date": str(dt.date.today()), "commit": commit, "prices": price_sums(lattice)}
    arrays = {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "ends": found.ends,
        "energy_j": found.energy_j,
        "grid_j": found.grid_j.astype(np.float32),
        "cpu_ms": found.cpu_ms.astype(np.float32),
        "route": np.round(100.0 * found.route_cells).astype(np.int16),
    }
    np.savez_compressed(STORED, **(kept | {f"{case.name}/{name}": array for name, array in arrays.items()}))


def stored(case: Case) -> tuple[Answers, dict]:
    """The stored answers of one map, and what is known of them."""
    with np.load(STORED) as file:
        about = json.loads(file[f"{case.name}/about"].tobytes())
        named = (file[f"{case.name}/{name}"] for name in ("ends", "energy_j", "grid_j", "cpu_ms"))
        return Answers(*named, route_cells=file[f"{case.name}/route"] / 100.0), about


@dataclass(frozen=True, eq=False)
class Compared:
    """The present code beside the stored answers of one map.

    gaps, grid_gaps : energy of the answer, and of the stored grid path, over that of the stored answer, less 1;
    other_way : which routes go elsewhere.
    """

    gaps: NDArray[np.float64]
    grid_gaps: NDArray[np.float64]
    other_way: NDArray[np.bool_]
    cpu_ms: NDArray[np.float64]
    stored_cpu_ms: NDArray[np.float64]


def compared(case: Case, real: Heightmap | None, tasks: int | None = None) -> Compared | None:
    """The first tasks of a map, or all; None where its moves cost something else now, so that no search is to blame."""
    lattice = lattice_of(case, real)
    old, about = stored(case)
    if not np.allclose(price_sums(lattice), about["prices"], rtol=SAME_PRICES, atol=0.0):
        return None
    part = slice(0, tasks)
    new = answers(lattice, old.ends[part])
    other_way = [
        cdist(was, subdivided(now, 1.0)).min(axis=1).max() > OTHER_WAY_CELLS
        for was, now in zip(old.route_cells[part], new.route_cells, strict=True)
    ]
    gaps, grid_gaps = (energy / old.energy_j[part] - 1.0 for energy in (new.energy_j, old.grid_j[part]))
    return Compared(gaps, grid_gaps, np.array(other_way), new.cpu_ms, old.cpu_ms[part])


def drawn(rows: dict[str, Compared | None]) -> Table:
    table = Table(title="energy above that of the stored answers")
    columns = (
        "mean %",
        "95 % below %",
        "worst %",
        "<= 0.2 %",
        "<= 1 %",
        "elsewhere",
        "grid's mean %",
        "CPU ms, median",
    )
    for column in ("map", "tasks", *columns, "when stored"):
        table.add_column(column, justify="left" if column == "map" else "right")
    for name, row in rows.items():
        if row is None:
            table.add_row(f"{name}: ITS MOVES COST SOMETHING ELSE than when answers were stored")
            continue
        gaps = 100.0 * row.gaps
        shares = ((gaps <= 0.2).mean(), (gaps <= 1.0).mean(), row.other_way.mean())
        table.add_row(
            name,
            str(gaps.size),
            *(f"{figure:.3f}" for figure in (gaps.mean(), np.percentile(gaps, 95), gaps.max())),
            *(f"{100.0 * share:.0f} %" for share in shares),
            f"{100.0 * row.grid_gaps.mean():.2f}",
            *(f"{np.median(ms):.0f}" for ms in (row.cpu_ms, row.stored_cpu_ms)),
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="store the present answers instead of comparing")
    parser.add_argument("--map", default="", metavar="NAME", help="only maps that have this in their name")
    parser.add_argument("--tasks", type=int, help="of each map; all by default, 200 with --write")
    parser.add_argument("--real", type=Path, help="the heightmap of the hillside, for the maps that need it")
    options = parser.parse_args()
    real = read_heightmap(options.real) if options.real else None
    cases = [case for case in CASES if options.map in case.name and (real is not None or case.heightmap is not None)]
    rows: dict[str, Compared | None] = {}
    for case in cases:
        if options.write:
            lattice = lattice_of(case, real)
            ends = random_ends(lattice, options.tasks or 200, SEED + zlib.crc32(case.name.encode()))
            store(case, lattice, answers(lattice, ends), _commit())
            print(f"{case.name}: {len(ends)} answers stored", flush=True)
        elif f"{case.name}/about" in np.load(STORED):
            rows[case.name] = compared(case, real, options.tasks)
        else:
            print(f"{case.name}: nothing is stored")
    if rows:
        Console(width=160).print(drawn(rows))


def _commit() -> str:
    words = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
