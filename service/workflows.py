"""Joins a predictor to a lattice, and a lattice to a question: HTTP, jobs, command line and Python all call this."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.battery import Battery
from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError, NoRouteError, TooLargeError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.windows import Ground
from joulemap.planner.budget import Verdict, judge_course
from joulemap.planner.course import course_of
from joulemap.planner.edges import energy_per_m_at
from joulemap.planner.figures import figures_of, joined_figures
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice_build import DEFAULT_HEADINGS, build_lattice, write_lattice
from joulemap.planner.route import Route
from joulemap.planner.tiles import Tiling
from joulemap.service.coordinates import PlaceLike
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.models import DEFAULT_MODEL, find_predictor, planning_robot
from joulemap.service.places import Places
from joulemap.service.route_uncertainty import odds_along

if TYPE_CHECKING:  # a cost map is made without them, and they take their time to load
    from joulemap.planner.plan import RoutePlanner
    from joulemap.planner.stored_planner import StoredPlanner
    from joulemap.service.objectives import Objective, Weighed


def check_lattice(frame: GridFrame, *, spacing_m: float, headings: int, max_values: int | None = None) -> Tiling:
    """Return the tiles of the cost lattice over a heightmap, without building it.

    Parameters
    ----------
    frame : GridFrame
        Frame of the heightmap.
    spacing_m : float
        Side of a cell of the lattice [m].
    headings : int
        Number of heading bins.
    max_values : int, optional
        Most values (rows * cols * headings) that the lattice may have. Without it any number is allowed.

    Returns
    -------
    Tiling
        The lattice's frame, cut into tiles.

    Raises
    ------
    HeightmapError
        If the spacing does not fit the map.
    InputError
        If the number of headings is out of range.
    TooLargeError
        If the lattice has more than `max_values` values.
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
    """Return what a cost lattice is built from: the robot, the model and the tiles.

    Parameters
    ----------
    ground : Ground
        The heightmap.
    robot : Robot
        The robot that drives.
    model : str or Path, optional
        Name, id or folder of the model, see `find_predictor`.
    spacing_m : float, optional
        Side of a cell [m].
    headings : int, optional
        Number of heading bins.
    models_dir : Path, optional
        Folder of trained models, see `find_predictor`.
    max_values : int, optional
        Most values of the lattice, see `check_lattice`.

    Returns
    -------
    robot : Robot
        With the energy of turning that the model learned, where it learned one.
    predictor : Predictor
        The model.
    tiling : Tiling
        The tiles of the lattice.

    Raises
    ------
    ModelError
        If there is no such model, or its files do not fit together.
    HeightmapError
        If the spacing does not fit the map.
    InputError
        If the number of headings is out of range.
    TooLargeError
        If the lattice has more than `max_values` values.
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
    """Return the cost lattice of a heightmap for a robot, in memory.

    Parameters
    ----------
    ground : Ground
        The heightmap.
    robot : Robot
        The robot that drives.
    model : str or Path, optional
        Name, id or folder of the model, see `find_predictor`.
    spacing_m : float, optional
        Side of a cell [m].
    headings : int, optional
        Number of heading bins.
    models_dir : Path, optional
        Folder of trained models, see `find_predictor`.
    progress : callable, optional
        Called with the share that is done, 0..1.

    Returns
    -------
    CostLattice
        Prices [J/m] and limits of every cell in every heading.

    Raises
    ------
    ModelError
        If there is no such model, or its files do not fit together.
    HeightmapError
        If the spacing does not fit the map.
    InputError
        If the number of headings is out of range.
    TooLargeError
        If the lattice does not fit into memory.
    """
    robot, predictor, _ = prepare_build(
        ground, robot, model=model, spacing_m=spacing_m, headings=headings, models_dir=models_dir
    )
    return build_lattice(ground, robot, predictor, spacing_m=spacing_m, headings=headings, progress=progress)


@dataclass(frozen=True)
class Written:
    """A cost lattice that was written to disk.

    Attributes
    ----------
    frame : GridFrame
        Where its cells lie.
    robot : Robot
        The robot that it was built for, with the energy of turning that the model learned.
    provenance : dict
        How it was made, JSON-able.
    figures : dict
        As `summarise` returns them.
    """

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
    """Write a cost lattice of any size into a folder, tile by tile.

    Parameters
    ----------
    path : Path
        The folder to write (Zarr).
    ground : Ground
        The heightmap.
    robot : Robot
        The robot that drives.
    model : str or Path, optional
        Name or folder of the model, see `find_predictor`.
    spacing_m : float, optional
        Side of a cell [m].
    headings : int, optional
        Number of heading bins.
    progress : callable, optional
        Called with the share that is done, 0..1.

    Returns
    -------
    Written
        What was written. The lattice itself is never held in memory as a whole.

    Raises
    ------
    ModelError
        If there is no such model, or its files do not fit together.
    HeightmapError
        If the spacing does not fit the map.
    InputError
        If the number of headings is out of range.
    """
    robot, predictor, tiling = prepare_build(ground, robot, model=model, spacing_m=spacing_m, headings=headings)
    parts: list[dict[str, Any]] = []
    provenance = write_lattice(
        path, ground, robot, predictor, tiling, each=lambda part: parts.append(figures_of(part)), progress=progress
    )
    return Written(tiling.frame, robot, provenance, joined_figures(parts))


def summarise(lattice: CostLattice) -> dict[str, Any]:
    """Return the figures that describe a lattice as a whole.

    Parameters
    ----------
    lattice : CostLattice
        In memory.

    Returns
    -------
    dict
        ``energy_per_m`` (min, mean and max [J/m], or None where nothing may be driven) and ``blocked`` (share of
        (cell, heading) pairs by reason).
    """
    return joined_figures([figures_of(lattice)])


@dataclass(frozen=True, eq=False)
class PointCosts:
    """What driving costs at one place.

    Attributes
    ----------
    headings_rad : ndarray of float64, (K,)
        Clockwise from north [rad].
    energy_per_m : ndarray of float64, (K,)
        Energy per metre [J/m], NaN where driving is not allowed.
    reasons : list of str or None, (K,)
        Why driving is not allowed in a heading; None where it is.
    elevation_m : float
        Height of the cell [m], NaN where unknown.
    """

    headings_rad: np.ndarray
    energy_per_m: np.ndarray
    reasons: list[str | None]
    elevation_m: float


def costs_at(lattice: CostLattice, x: float, y: float) -> PointCosts:
    """Return the energy per metre in all headings at one place, and why some headings are blocked.

    The energy is interpolated as for the price of a path, between up to four cells. The reason is that of the nearest
    of these cells that is blocked.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    x, y : float
        World coordinates [m].

    Returns
    -------
    PointCosts
        Energy and reason by heading.

    Raises
    ------
    PointError
        If the place lies outside the map.
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
    """Whether a battery lasts for a task, and the routes that this was decided with.

    Attributes
    ----------
    verdict : Verdict
        For all routes together.
    route_out : Route
        The way there.
    route_back : Route or None
        The way back of a round trip.
    weighed : Weighed or None
        How the routes do by their objective; None for the least expected energy, and for a given path.
    """

    verdict: Verdict
    route_out: Route
    route_back: Route | None = None
    weighed: Weighed | None = None

    @property
    def routes(self) -> list[Route]:
        """What is driven, in this order."""
        return [route for route in (self.route_out, self.route_back) if route is not None]


def assess(
    planner: RoutePlanner | StoredPlanner | CostLattice,
    *,
    battery: Battery,
    path: ArrayLike | Sequence[Any] | None = None,
    start: PlaceLike | None = None,
    goal: PlaceLike | None = None,
    round_trip: bool = False,
    snap: bool = False,
    objective: Objective | None = None,
) -> Assessment:
    """Return whether a battery lasts for a given path, or for the best route from start to goal.

    Give either `path`, or `start` and `goal`.

    Parameters
    ----------
    planner : RoutePlanner, StoredPlanner or CostLattice
        The map to drive on.
    battery : Battery
        Its capacity, charge and reserve.
    path : array_like, (n, 2), optional
        World points [m], or places as `Places.path` takes them, in the order of driving.
    start, goal : sequence of float or mapping, optional
        World x, y [m], or a place as `world_point` takes it.
    round_trip : bool, optional
        Judge the way back too. A given path is driven back in the opposite direction, each leg at its reversed
        heading. From goal to start the best route is searched anew: on a slope it need not be the same.
    snap : bool, optional
        Move a start or goal on blocked ground to the nearest free place; the route's notes say where.
    objective : Objective, optional
        What the routes from start to goal and back are chosen by, together. By default their expected energy.

    Returns
    -------
    Assessment
        The verdict and its routes.

    Raises
    ------
    InputError
        If not exactly one of `path`, and `start` with `goal`, is given, or the objective cannot be weighed.
    PointError
        If a point lies outside the map.
    BlockedError
        If start or goal is on blocked ground without `snap`, or if a leg of the path is.
    NoRouteError
        If no route joins start and goal.
    """
    from joulemap.planner.plan import RoutePlanner
    from joulemap.planner.stored_planner import StoredPlanner
    from joulemap.service.objectives import MEAN, best_routes

    if (path is None) == (start is None and goal is None) or (start is None) != (goal is None):
        raise InputError("give either `path`, or `start` and `goal`")
    back = None
    lattice = planner if isinstance(planner, CostLattice) else planner.lattice
    places = Places(lattice.frame)
    if path is not None:
        points = places.path(path)
        if isinstance(planner, StoredPlanner):
            planner.read_along(points)
        out = price_given_path(lattice, points)
        if round_trip:
            back = price_given_path(lattice, points[::-1])
    else:
        assert start is not None
        assert goal is not None
        router = RoutePlanner(planner) if isinstance(planner, CostLattice) else planner
        there, home = places(start, "start"), places(goal, "goal")
        out = router.plan(there, home, snap=snap).route
        if round_trip:
            if snap:  # back from where the way there ended, and to where it began
                there, home = ((float(x), float(y)) for x, y in out.points[[0, -1], :2])
            back = router.plan(home, there).route
    routes, weighed = tuple(route for route in (out, back) if route is not None), None
    if path is None and objective is not None and objective.name != MEAN:
        routes, weighed = best_routes(router, routes, objective, battery=battery)
    verdict = judge_routes(lattice, routes, battery)
    return Assessment(verdict, places.noted(routes[0]), routes[1] if round_trip else None, weighed)


def judge_routes(lattice: CostLattice, routes: Sequence[Route], battery: Battery) -> Verdict:
    """Return the verdict for routes that are driven one after another.

    Parameters
    ----------
    lattice : CostLattice
        That all routes were priced with.
    routes : sequence of Route
        In the order of driving.
    battery : Battery
        Its capacity, charge and reserve.

    Returns
    -------
    Verdict
        With a probability where the lattice's model knows its own uncertainty.

    Raises
    ------
    InputError
        If the battery's cut-off voltage is above every voltage that it has.
    """
    return judge_course(
        course_of(routes),
        battery,
        nominal_voltage_v=lattice.robot.nominal_voltage_v,
        odds=odds_along(routes),
    )


def warm_up(*, models: Sequence[str] = (DEFAULT_MODEL,), models_dir: Path | None = None) -> float:
    """Load every compiled kernel and the named models, and return how long it took.

    Runs everything once on a tiny map: lattice, every planner with and without turning, verdicts, a measured run. A
    kernel that is in no cache is compiled.

    Parameters
    ----------
    models : sequence of str, optional
        Names of models to load.
    models_dir : Path, optional
        Folder of trained models, see `find_predictor`.

    Returns
    -------
    float
        Seconds that it took.

    Raises
    ------
    ModelError
        If there is no such model, or its files do not fit together.
    """
    from joulemap.model.runs.cutting import cut_segments
    from joulemap.model.runs.reader import run_of
    from joulemap.planner.plan import PLANNERS, RoutePlanner

    began = time.perf_counter()
    heightmap = _small_map()
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
    warm_up_models(models, models_dir=models_dir)
    return time.perf_counter() - began


def warm_up_models(models: Sequence[str], *, models_dir: Path | None = None) -> None:
    """Load the named models, and the kernels with which cost maps are made.

    Parameters
    ----------
    models : sequence of str
        Names of models to load.
    models_dir : Path, optional
        Folder of trained models, see `find_predictor`.

    Raises
    ------
    ModelError
        If there is no such model, or its files do not fit together.
    """
    for model in models:
        for spacing_m in (1.0, 3.0):  # a network answers these by dense passes and by single squares
            lattice = make_cost_lattice(_small_map(), Robot(), model=model, spacing_m=spacing_m, models_dir=models_dir)
            summarise(lattice)


def _small_map() -> Heightmap:
    rows = np.arange(12.0)
    heights = 0.2 * np.sin(rows)[:, None] + 0.1 * rows[None, :]
    heights[0, 11] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(0.0, 12.0, 1.0, 12, 12))
