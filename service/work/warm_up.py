"""Loads every compiled kernel and the named models, so that the first question need not wait for them."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from joulemap.model.compiling import NOTICE
from joulemap.model.errors import NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.grid.stopping import check_stop
from joulemap.service.analysis.cost_lattices import make_cost_lattice, summarise
from joulemap.service.analysis.feasibility import assess
from joulemap.service.analysis.point_costs import costs_at
from joulemap.service.models import DEFAULT_MODEL


def warm_up(*, models: Sequence[str] = (DEFAULT_MODEL,), models_dir: Path | None = None) -> float:
    """Load every compiled kernel and the named models, and return how long it took.

    Runs everything once on a tiny map: lattice, every planner with and without turning, a search with a turning radius,
    verdicts, a search on disk, a measured run. A kernel that is in no cache is compiled. Under a flag of
    `planner.grid.stopping` it ends between two.
    """
    from joulemap.model.runs.cutting import cut_segments
    from joulemap.model.runs.reader import run_of
    from joulemap.planner.lattice.folder import save_lattice
    from joulemap.planner.route_planner import PLANNERS, RouteOptions, RoutePlanner
    from joulemap.planner.stored_planner import StoredPlanner

    NOTICE.silence()
    began = time.perf_counter()
    heightmap = _small_map()
    heightmap.sample([5.0], [5.0])
    for robot in (Robot(), Robot(regeneration=0.3, turn_j_per_rad=1.0)):
        lattice = make_cost_lattice(heightmap, robot, model="physics")
        summarise(lattice)
        costs_at(lattice, 6.3, 6.4)
        router = RoutePlanner(lattice)
        for planner in PLANNERS:
            check_stop()
            with suppress(NoRouteError):  # a sampling planner on a busy machine may find none in so short a time
                router.plan((2.2, 2.3), (9.1, 8.7), RouteOptions(planner=planner, time_limit_s=0.05, alternatives=1))
        check_stop()
        assess(router, battery=robot.battery, start=(2.2, 2.3), goal=(9.1, 8.7), round_trip=True)
        with tempfile.TemporaryDirectory() as folder:
            save_lattice(lattice, f"{folder}/map.zarr")
            check_stop()
            StoredPlanner(f"{folder}/map.zarr").plan((2.2, 2.3), (9.1, 8.7))
    check_stop()
    curved = make_cost_lattice(heightmap, Robot(min_turning_radius_m=1.0), model="physics")
    RoutePlanner(curved).plan((2.2, 2.3), (9.1, 8.7), RouteOptions(goal_heading_deg=0.0))
    seconds = np.arange(0.0, 20.0, 0.1)
    columns = {"t": seconds, "x": 0.5 * seconds, "y": np.sin(seconds), "current": np.ones(seconds.size)}
    cut_segments(run_of(columns, {}, name="warm-up"), charge=True)
    warm_up_models(models, models_dir=models_dir)
    return time.perf_counter() - began


def warm_up_models(models: Sequence[str], *, models_dir: Path | None = None) -> None:
    """Load the named models, and the kernels with which cost maps are made."""
    for model in models:
        for spacing_m in (1.0, 3.0):  # a network answers these by dense passes and by single squares
            lattice = make_cost_lattice(_small_map(), Robot(), model=model, spacing_m=spacing_m, models_dir=models_dir)
            summarise(lattice)


def _small_map() -> Heightmap:
    rows = np.arange(12.0)
    heights = 0.2 * np.sin(rows)[:, None] + 0.1 * rows[None, :]
    heights[0, 11] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(0.0, 12.0, 1.0, 12, 12))
