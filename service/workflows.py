"""Joins a predictor to a lattice, and a lattice to a question: what HTTP, jobs and the command line all call."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError, NoRouteError, TooLargeError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Battery, Robot
from joulemap.model.runs.reader import run_of
from joulemap.model.runs.segments import cut_segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.windows import Ground
from joulemap.planner.budget import Verdict, judge_along
from joulemap.planner.edges import energy_per_m_at
from joulemap.planner.figures import figures_of, joined_figures
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice_build import DEFAULT_HEADINGS, build_lattice, write_lattice
from joulemap.planner.plan import PLANNERS, RoutePlanner
from joulemap.planner.route import Route, price_route
from joulemap.planner.tiles import Tiling
from joulemap.service.models import DEFAULT_MODEL, find_predictor, planning_robot
from joulemap.service.route_uncertainty import std_along


def check_lattice(frame: GridFrame, *, spacing_m: float, headings: int, max_values: int | None = None) -> Tiling:
    """The tiles of the cost lattice over a heightmap's `frame`, without building it.

    Raises HeightmapError where the spacing does not fit the map, InputError on a bad number of headings, TooLargeError
    above `max_values` (rows * cols * headings).
    """
    tiling = Tiling.of(frame, spacing_m=spacing_m, headings=headings)
    if max_values is not None and tiling.values > max_values:
        raise TooLargeError(
            f"{tiling.frame.rows} x {tiling.frame.cols} cells at {headings} headings are {tiling.values:,} values, the "
            f"limit is {max_values:,}: choose a larger spacing than {spacing_m:g} m, or fewer headings",
            values=tiling.values,
            limit=max_values,
        )
    return tiling


def prepare_build(
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    models_dir: Path | None = None,
    max_values: int | None = None,
) -> tuple[Robot, Predictor, Tiling]:
    """What a cost lattice is built of: the robot as the model knows it, the model of that name, the tiles.

    Arguments and what is raised as `make_cost_lattice`.
    """
    tiling = check_lattice(ground.frame, spacing_m=spacing_m, headings=headings, max_values=max_values)
    predictor = find_predictor(model, models_dir=models_dir)
    return planning_robot(predictor, robot), predictor, tiling


def make_cost_lattice(
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    models_dir: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> CostLattice:
    """The cost lattice of a heightmap for a robot, by the model of that name (see `find_predictor`), in memory.

    spacing_m : side of a cell [m]; headings : number of bins; progress : called with 0..1. Raises ModelError,
    HeightmapError, InputError, TooLargeError.
    """
    robot, predictor, _ = prepare_build(
        ground, robot, model=model, spacing_m=spacing_m, headings=headings, models_dir=models_dir
    )
    return build_lattice(ground, robot, predictor, spacing_m=spacing_m, headings=headings, progress=progress)


@dataclass(frozen=True)
class Written:
    """A cost lattice on disk. robot : as it was built for; figures : as `summarise`."""

    frame: GridFrame
    robot: Robot
    provenance: dict[str, Any]
    figures: dict[str, Any]


def write_cost_lattice(
    path: Path,
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    progress: Callable[[float], None] | None = None,
) -> Written:
    """`make_cost_lattice` of any size into the folder `path`, tile by tile, never holding the whole."""
    robot, predictor, tiling = prepare_build(ground, robot, model=model, spacing_m=spacing_m, headings=headings)
    parts: list[dict[str, Any]] = []
    provenance = write_lattice(
        path, ground, robot, predictor, tiling, each=lambda part: parts.append(figures_of(part)), progress=progress
    )
    return Written(tiling.frame, robot, provenance, joined_figures(parts))


def summarise(lattice: CostLattice) -> dict[str, Any]:
    """`joined_figures` of a lattice in memory."""
    return joined_figures([figures_of(lattice)])


@dataclass(frozen=True, eq=False)
class PointCosts:
    """What driving costs at one place. energy_per_m : (K,) [J/m], NaN where blocked; reasons : (K,) labels or None."""

    headings_rad: np.ndarray
    energy_per_m: np.ndarray
    reasons: list[str | None]
    elevation_m: float


def costs_at(lattice: CostLattice, x: float, y: float) -> PointCosts:
    """Energy per metre over all headings at a world point, and the reason where it may not be driven.

    The energy is the interpolated one that paths are priced with. It leans on up to four cells: the reason is that of
    the nearest of them that is blocked. Raises PointError outside the map.
    """
    row, col = lattice.frame.cell_of(x, y)
    headings = heading_bins(lattice.headings)
    energy = energy_per_m_at(lattice, x, y, headings)
    at_row, at_col = (float(v) for v in lattice.frame.rowcol(x, y))
    near = [
        (r, c)
        for r in range(max(int(np.floor(at_row)), 0), min(int(np.floor(at_row)) + 2, lattice.frame.rows))
        for c in range(max(int(np.floor(at_col)), 0), min(int(np.floor(at_col)) + 2, lattice.frame.cols))
    ]
    near.sort(key=lambda cell: (cell[0] - at_row) ** 2 + (cell[1] - at_col) ** 2)
    codes = np.stack([lattice.window(r, r + 1, c, c + 1).blocked_by_heading()[0, 0] for r, c in near])  # (cells, K)
    reasons: list[str | None] = []
    for k in range(lattice.headings):
        if np.isfinite(energy[k]):
            reasons.append(None)
        else:
            blocked = codes[:, k][codes[:, k] != Blocked.FREE]
            reasons.append(Blocked(int(blocked[0])).label if blocked.size else Blocked.UNKNOWN.label)
    return PointCosts(headings, energy, reasons, float(lattice.elevation_m[row, col]))


@dataclass(frozen=True, eq=False)
class Assessment:
    """Whether a battery lasts for a task, and the routes it was judged by. route_back : None unless a round trip."""

    verdict: Verdict
    route_out: Route
    route_back: Route | None = None


def assess(
    planner: RoutePlanner | CostLattice,
    *,
    battery: Battery,
    path: ArrayLike | None = None,
    start: Sequence[float] | None = None,
    goal: Sequence[float] | None = None,
    round_trip: bool = False,
) -> Assessment:
    """The verdict for driving a given `path` ((n, 2) world points [m]), or the best route from start to goal.

    round_trip : and back; a given path in the opposite direction, each leg at its reversed heading; start and goal by
    the best route back, which on a slope need not be the same. Raises InputError unless exactly one of `path` and
    `start` with `goal` is given; PointError, BlockedError, NoRouteError.
    """
    if (path is None) == (start is None and goal is None) or (start is None) != (goal is None):
        raise InputError("give either `path`, or `start` and `goal`")
    back = None
    lattice = planner.lattice if isinstance(planner, RoutePlanner) else planner
    if path is not None:
        points = np.asarray(path, dtype=np.float64)
        out = price_route(lattice, points)
        if round_trip:
            back = price_route(lattice, points[::-1])
    else:
        assert start is not None
        assert goal is not None
        router = planner if isinstance(planner, RoutePlanner) else RoutePlanner(planner)
        there, home = (float(start[0]), float(start[1])), (float(goal[0]), float(goal[1]))
        out = router.plan(there, home).route
        if round_trip:
            back = router.plan(home, there).route
    routes = [route for route in (out, back) if route is not None]
    return Assessment(judge_routes(lattice, routes, battery), out, back)


def judge_routes(lattice: CostLattice, routes: Sequence[Route], battery: Battery) -> Verdict:
    """The verdict for routes of one lattice driven one after another, with a probability where its model knows how far
    off it may be.
    """
    pieces = np.concatenate([route.profile.energy_j for route in routes])
    return judge_along(pieces, battery, std_j=std_along(lattice, routes))


def warm_up(*, models: Sequence[str] = (DEFAULT_MODEL,), models_dir: Path | None = None) -> float:
    """Seconds spent on loading every compiled kernel (compiling it where no cache has it) and the named models.

    Runs the whole way once on a tiny map: lattice, every planner with and without turning, verdicts, a measured run.
    """
    began = time.perf_counter()
    rows = np.arange(12.0)
    heights = 0.2 * np.sin(rows)[:, None] + 0.1 * rows[None, :]
    heights[0, 11] = np.nan
    heightmap = Heightmap(heights.astype(np.float32), GridFrame(0.0, 12.0, 1.0, 12, 12))
    heightmap.sample([5.0], [5.0])
    for robot in (Robot(), Robot(regeneration=0.3, turn_j_per_rad=1.0)):
        lattice = make_cost_lattice(heightmap, robot, model="physics")
        summarise(lattice)
        costs_at(lattice, 6.3, 6.4)
        router = RoutePlanner(lattice)
        for planner in PLANNERS:
            with suppress(NoRouteError):  # a sampling planner on a busy machine may find none in so short a time
                router.plan((2.2, 2.3), (9.1, 8.7), planner=planner, time_limit_s=0.05, alternatives=1)
        assess(router, battery=robot.battery, start=(2.2, 2.3), goal=(9.1, 8.7), round_trip=True)
    seconds = np.arange(0.0, 20.0, 0.1)
    columns = {"t": seconds, "x": 0.5 * seconds, "y": np.sin(seconds), "current": np.ones(seconds.size)}
    cut_segments(run_of(columns, {}, name="warm-up"), charge=True)
    for model in models:
        for spacing_m in (1.0, 3.0):  # a network answers these by dense passes and by single squares
            make_cost_lattice(heightmap, Robot(), model=model, spacing_m=spacing_m, models_dir=models_dir)
    return time.perf_counter() - began
