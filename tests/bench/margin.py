"""What the margin to closed ground costs, and how seldom paths that keep it meet closed ground beside their line.

python -m tests.bench.margin [--map NAME] [--tasks N] [--real HEIGHTMAP]

The tasks are those of `tests.bench.guard`. All of a path is shifted by one random vector a run, of 0.1 m standard
deviation to the east and to the north; energies are means of the runs that may be driven.
"""

from __future__ import annotations

import argparse
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import metres_within_margin, path_price
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.library.heightmaps import read_heightmap
from tests.bench.guard import CASES, SEED, lattice_of, random_ends

SHIFT_M, RUNS, TRACKING_STD_M = 0.1, 20, 0.1


def judged(lattice: CostLattice, rover: CostLattice, ends: np.ndarray) -> dict[str, np.ndarray]:
    """Of each task: energy [J], energy when shifted [J], share of runs that meet closed ground, metres, CPU [ms].

    lattice : with the robot that plans; rover : with one whose margin judges.
    """
    planner, rng = RoutePlanner(lattice), np.random.default_rng(SEED)
    planner.prepare()
    rows = []
    for k in [0, *range(len(ends))]:
        start, goal = (tuple(float(v) for v in lattice.frame.xy(*end)) for end in (ends[k, :2], ends[k, 2:]))
        began = time.process_time()
        route = planner.plan(start, goal).route
        spent = 1e3 * (time.process_time() - began)
        points = np.column_stack(lattice.frame.rowcol(*route.points[:, :2].T))
        shifts = rng.normal(0.0, SHIFT_M / lattice.frame.resolution_m, (RUNS, 2))
        driven = np.array([path_price(lattice, points + shift) for shift in shifts])
        closed = np.isnan(driven)
        mean = float(driven[~closed].mean()) if not closed.all() else np.nan
        rows.append((route.energy_j, mean, closed.mean(), metres_within_margin(rover, points), spent))
    names = ("energy_j", "shifted_j", "closed", "within_m", "cpu_ms")
    return dict(zip(names, np.array(rows[1:]).T, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", default="", metavar="NAME", help="only maps that have this in their name")
    parser.add_argument("--tasks", type=int, default=50, help="of each map")
    parser.add_argument("--real", type=Path, help="the heightmap of the hillside, for the maps that need it")
    options = parser.parse_args()
    real = read_heightmap(options.real) if options.real else None
    table = Table(title=f"the margin of a robot that drives {TRACKING_STD_M:g} m beside its path")
    for column in (
        "map",
        "margin",
        "energy %",
        "shifted by 0.1 m %",
        "meets closed %",
        "within it, m",
        "CPU ms, median",
    ):
        table.add_column(column, justify="left" if column in ("map", "margin") else "right")
    for case in CASES:
        if options.map not in case.name or (real is None and case.heightmap is None):
            continue
        exact = lattice_of(case, real)
        rover = replace(exact, robot=replace(exact.robot, tracking_std_m=TRACKING_STD_M))
        ends = random_ends(exact, options.tasks, SEED + zlib.crc32(case.name.encode()))
        rows = {"none": judged(exact, rover, ends), "kept": judged(rover, rover, ends)}
        usual_j = rows["none"]["energy_j"]
        for name, found in rows.items():
            energy, shifted = (100.0 * (found[key] / usual_j - 1.0) for key in ("energy_j", "shifted_j"))
            table.add_row(
                case.name if name == "none" else "",
                name,
                f"{energy.mean():.2f}",
                f"{np.nanmean(shifted):.2f}",
                f"{100.0 * found['closed'].mean():.1f}",
                f"{found['within_m'].mean():.2f}",
                f"{np.median(found['cpu_ms']):.0f}",
            )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
