"""How well routes survive other programs' files: positions, energies and free ground, over random maps.

python -m tests.bench.exports --maps 20
"""

from __future__ import annotations

import argparse

import numpy as np
from pyproj import Transformer
from rich.console import Console
from rich.table import Table

import joulemap as jm
from joulemap.planner.edges import leg_prices, price_world_path, world_points
from joulemap.service.exports.mission import mission_of
from joulemap.service.exports.positions import degrees_of
from tests.service.test_exports import WESTERN, at, ground


def compare_exports(maps: int, tasks: int) -> Table:
    """What other programs read, beside the routes: written plainly, as tracks, and as missions."""
    rng, back = np.random.default_rng(0), Transformer.from_crs("EPSG:4326", WESTERN[0], always_xy=True)
    there = Transformer.from_crs(WESTERN[0], "EPSG:4326", always_xy=True)
    rows: dict[str, list[tuple[float, float, bool, int]]] = {"plainly rounded": [], "track": [], "mission": []}
    for seed in range(maps):
        made = jm.costmap(ground(*WESTERN, seed=seed), model="physics")
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
                free = bool(np.isfinite(leg_prices(made.lattice, world_points(made.lattice, xy))).all())
                energy = price_world_path(made.lattice, xy) / route.energy_j - 1.0 if free else 0.0
                rows[name].append((float(away), abs(energy), free, len(xy)))
    table = Table(
        "written", "routes", "positions within [mm]", "energy within [%]", "on free ground", "corners, median"
    )
    for name, found in rows.items():
        away, energy, free, corners = (np.array(column) for column in zip(*found, strict=True))
        share = f"{free.sum()} of {len(free)}"
        table.add_row(
            name,
            str(len(found)),
            f"{1e3 * away.max():.1f}",
            f"{100 * energy.max():.3f}",
            share,
            f"{np.median(corners):g}",
        )
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=20)
    parser.add_argument("--tasks", type=int, default=5, help="routes on each map")
    options = parser.parse_args()
    Console(width=140).print(compare_exports(options.maps, options.tasks))
