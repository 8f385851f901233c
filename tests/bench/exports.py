"""How well routes survive other programs' files: positions, energies and free ground, over random maps.

python -m tests.bench.exports --maps 20 --seed 0

"Read as free" is what joulemap itself says of the file, as `joulemap feasibility --path FILE` does: corners that
rounding put onto blocked ground are moved by 1 cm at most. "As written" counts the paths for which no corner has to be
moved; a passage of a single cell is as narrow as a line, which no rounded position meets.
"""

from __future__ import annotations

import argparse

import numpy as np
from pyproj import Transformer
from rich.console import Console
from rich.table import Table

import joulemap as jm
from joulemap.model.errors import BlockedError
from joulemap.planner.pricing.integrator import leg_prices, world_points
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.exports.mission import mission_of
from joulemap.service.exports.track import degrees_of
from tests.service.test_exports import WESTERN, at, ground


def compare_exports(maps: int, tasks: int, seed: int) -> Table:
    """What other programs read, beside the routes: written plainly, as tracks, and as missions."""
    rng, back = np.random.default_rng(seed), Transformer.from_crs("EPSG:4326", WESTERN[0], always_xy=True)
    there = Transformer.from_crs(WESTERN[0], "EPSG:4326", always_xy=True)
    rows: dict[str, list[tuple[float, float, bool, bool, int]]] = {"plainly rounded": [], "track": [], "mission": []}
    for number in range(maps):
        made = jm.costmap(ground(*WESTERN, seed=1_000 * seed + number), model="physics")
        for _ in range(tasks):
            start, goal = (at(made.lattice.frame, tuple(rng.uniform(2.0, 78.0, 2))) for _ in range(2))
            try:
                route = made.plan(start, goal, snap=True)
            except jm.JoulemapError:
                continue
            line = route.track.driven[0]
            plain = np.round(np.column_stack(there.transform(*line.points[:, :2].T)), 9)
            written = (plain, degrees_of(route.track, line), np.array(mission_of(route.track).waypoints))
            for name, degrees in zip(rows, written, strict=True):
                xy = np.column_stack(back.transform(*degrees.T))
                away = np.hypot(*(xy[:, None] - line.points[None, :, :2]).transpose(2, 0, 1)).min(axis=1).max()
                written_free = bool(np.isfinite(leg_prices(made.lattice, world_points(made.lattice, xy))).all())
                try:
                    energy, free = price_given_path(made.lattice, xy).energy_j / route.energy_j - 1.0, True
                except BlockedError:
                    energy, free = 0.0, False
                rows[name].append((float(away), abs(energy), free, written_free, len(xy)))
    table = Table(
        "written",
        "routes",
        "positions within [mm]",
        "energy within [%]",
        "read as free",
        "as written",
        "corners, median",
    )
    for name, found in rows.items():
        away, energy, free, as_written, corners = (np.array(column) for column in zip(*found, strict=True))
        table.add_row(
            name,
            str(len(found)),
            f"{1e3 * away.max():.1f}",
            f"{100 * energy.max():.3f}",
            f"{free.sum()} of {len(free)}",
            f"{as_written.sum()} of {len(free)}",
            f"{np.median(corners):g}",
        )
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=20)
    parser.add_argument("--tasks", type=int, default=5, help="routes on each map")
    parser.add_argument("--seed", type=int, default=0, help="of the maps and of the places on them")
    options = parser.parse_args()
    Console(width=140).print(compare_exports(options.maps, options.tasks, options.seed))
