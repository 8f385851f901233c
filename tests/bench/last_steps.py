"""What the last steps of a short path save: the same random tasks with several settings of `joulemap.planner`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.table import Table

from joulemap.model.errors import JoulemapError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner import beside, best, rivals, scattered, shaken
from joulemap.planner.plan import RoutePlanner
from tests.bench.quality import NOTICED, quality_maps

Setting = Mapping[ModuleType, Mapping[str, Any]]
SETTINGS: Mapping[str, Setting] = {
    "none of these": {beside: {"MOST_CELLS": 0.0}, shaken: {"ROUNDS": 0}, best: {"MOST_CELLS": 0.0}},
    "passages only where they differ": {best: {"MOST_CELLS": 0.0}},
    "no ways beside a path": {beside: {"MOST_CELLS": 0.0}},
    "three of six ribbons": {beside: {"RIBBONS": [part for part in beside.RIBBONS if part.spacing in (4, 12, 16)]}},
    "not shaken": {shaken: {"ROUNDS": 0}},
    "no further rounds beside closed ground": {shaken: {"_closed_stretches": lambda *_: []}},
    "no places at random": {scattered: {"SPREADS_CELLS": np.zeros(0)}},
    "no tube around stretches": {shaken: {"with_way_around": lambda _, points, **__: points}},
    "no rivals": {rivals: {"ROUNDS": 0}},
    "as it is": {},
    "twice as many copies": {shaken: {name: 2 * vars(shaken)[name] for name in ("COPIES", "STRETCH_COPIES")}},
    "twice the patience": {shaken: {"STRETCH_PATIENCE": 2 * shaken.STRETCH_PATIENCE}},
    "twice as many places": {scattered: {"SPREADS_CELLS": np.repeat(scattered.SPREADS_CELLS, 2)}},
    "up to 300 cells": {module: {"MOST_CELLS": 300.0} for module in (best, beside, shaken)},
}
"""Constants that differ, by module."""


def compare_last_steps(
    heightmap: Heightmap | None, tasks: int, seed: int, settings: Mapping[str, Setting] = SETTINGS
) -> Table:
    """How much dearer than the best of all settings the answer of each is, and its processor time."""
    gaps: dict[str, list[float]] = {name: [] for name in settings}
    spent, longest = dict.fromkeys(settings, 0.0), 0.0
    for _, lattice in quality_maps(heightmap):
        planner = RoutePlanner(lattice)
        planner.prepare()
        free = np.argwhere(lattice.blocked == 0).astype(float)
        rng = np.random.default_rng(seed)
        done = 0
        while done < tasks:
            start, goal = free[rng.integers(len(free), size=2)]
            if np.abs(start - goal).max() < 5.0:
                continue
            ends = [tuple(float(v) for v in lattice.frame.xy(*end)) for end in (start, goal)]
            energies = {}
            try:
                if done == 0:
                    planner.plan(*ends)  # whatever is loaded or compiled is, before anything is timed
                for name, changed in settings.items():
                    with ExitStack() as stack:
                        for module, constants in changed.items():
                            stack.enter_context(patch.dict(vars(module), constants))
                        began = time.process_time()
                        energies[name] = planner.plan(*ends).route.energy_j
                        spent[name] += time.process_time() - began
            except JoulemapError:
                continue
            done += 1
            longest = max(longest, float(np.abs(start - goal).max()))
            for name, energy in energies.items():
                gaps[name].append(energy / min(energies.values()) - 1.0)
    count = len(next(iter(gaps.values())))
    out = Table(title=f"last steps of a short path, {count} random tasks of up to {longest:.0f} cells")
    for column in ("settings", "tasks above 0.1 %", "mean gap %", "worst %", "processor ms an answer"):
        out.add_column(column, justify="left" if column == "settings" else "right")
    for name, values in gaps.items():
        share = 100.0 * np.array(values)
        out.add_row(
            name,
            str(int((share > 100.0 * NOTICED).sum())),
            f"{share.mean():.4f}",
            f"{share.max():.3f}",
            f"{1e3 * spent[name] / count:.0f}",
        )
    return out
