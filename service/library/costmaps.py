"""The cost map of a Python user: made of a heightmap, asked for routes and verdicts, drawn, saved and exported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.battery import Battery
from joulemap.model.errors import ConflictError, InputError
from joulemap.model.robot import Robot
from joulemap.planner.energy_map import EnergyMap, energy_map
from joulemap.planner.fields import field_from, field_towards
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice_build import DEFAULT_HEADINGS
from joulemap.planner.lattice_io import load_lattice, save_lattice
from joulemap.planner.moves import move_table
from joulemap.planner.places import end_point
from joulemap.planner.plan import RoutePlanner
from joulemap.planner.reach_map import ReachMap
from joulemap.planner.route import Route
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.planner.tiled_search import DEFAULT_MEMORY
from joulemap.service.coordinates import PlaceLike
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.exports.maps import save_map
from joulemap.service.homeward import CONFIDENCE, Homeward, homeward
from joulemap.service.library.heightmaps import GroundLike, RobotLike, ground_of, robot_of
from joulemap.service.library.html import html_table, text_table
from joulemap.service.library.models import ModelLike, model_folder
from joulemap.service.library.routes import Feasibility, PlannedRoute, PlannedTour
from joulemap.service.models import DEFAULT_MODEL, find_predictor
from joulemap.service.objectives import Objective, limited, plan_by
from joulemap.service.places import Places
from joulemap.service.reach import reach_map
from joulemap.service.speeds import Speeds, speeds_along
from joulemap.service.workflows import PointCosts, assess, costs_at, judge_routes, make_cost_lattice, summarise

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

Point = PlaceLike
"""World x, y [m] in the CRS of the map; or latitude, longitude, see `joulemap.service.coordinates.world_point`."""


class CostMap:
    """What driving costs at every place and in every direction, for one robot on one heightmap.

    Parameters
    ----------
    lattice : CostLattice
        The prices, limits and heights.

    Attributes
    ----------
    lattice : CostLattice
        The prices, limits and heights, for the functions of `joulemap.planner`.
    """

    def __init__(self, lattice: CostLattice) -> None:
        self.lattice = lattice

    @property
    def _whole(self) -> CostLattice:
        """The lattice, for what needs all cells."""
        return self.lattice

    @property
    def robot(self) -> Robot:
        """The robot that the map is made for, with what its model found its turns to cost."""
        return self.lattice.robot

    @property
    def crs(self) -> str | None:
        """Coordinate system of the map, None where the heightmap did not name one."""
        return self.lattice.frame.crs

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north [m]."""
        return self.lattice.frame.bounds

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return list(self.lattice.provenance.get("warnings", []))

    @cached_property
    def planner(self) -> RoutePlanner:
        """The planner of this map. It keeps what repeated questions share."""
        return RoutePlanner(self.lattice)

    def plan(
        self,
        start: Point,
        goal: Point,
        *,
        planner: str = "astar",
        neighbours: int = 16,
        refine: bool = True,
        alternatives: int = 0,
        snap: bool = False,
        bound: bool = False,
        time_limit_s: float = 5.0,
        seed: int = 0,
        avoid: Sequence[Sequence[Point]] = (),
        objective: str = "mean",
        quantile: float = 0.95,
        max_power_w: float | None = None,
        battery: Battery | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> PlannedRoute:
        """Find the route of least energy, and the shortest one beside it.

        Parameters
        ----------
        start, goal : sequence of float
            World x, y [m].
        planner : str, optional
            One of `joulemap.planner.plan.PLANNERS`.
        neighbours : int, optional
            Directions of a step on the grid: 8, 16 or 32.
        refine : bool, optional
            Whether the grid's path is improved to any angle.
        alternatives : int, optional
            Most other routes to look for.
        snap : bool, optional
            Whether a start or goal on blocked ground is moved to the nearest free place.
        bound : bool, optional
            Whether to search for a sharper lower bound of the energy (`found.bound_j`), which takes some seconds once
            per map. Without it the bound is that of the idle power over the straight distance.
        time_limit_s : float, optional
            For the sampling planners [s].
        seed : int, optional
            For the sampling planners.
        avoid : sequence of sequence of points, optional
            Areas that no route may touch: the corners of each, world x, y [m].
        objective : str, optional
            What the route is chosen by: "mean" energy, energy at a "quantile", or probability of "arrival" with the
            reserve of the battery.
        quantile : float, optional
            Share of drives that take no more than the energy that is made least, 0.5 to 0.99.
        max_power_w : float, optional
            Most power at the robot's speed [W]: what takes more is blocked.
        battery : Battery, optional
            For "arrival".
        progress : callable, optional
            Called with the share done, 0..1.

        Returns
        -------
        PlannedRoute
            Energies in J. Its `objective` says how well it does by another objective than the mean.

        Raises
        ------
        InputError
            If the model does not know its uncertainty, and the objective is not the mean.
        PointError
            If a point or an area lies outside the map.
        BlockedError
            If a point lies on blocked ground, and `snap` is false.
        NoRouteError
            If no route joins the two.
        """
        places = Places(self.lattice.frame)
        router = limited(self.planner.avoiding(places.areas(avoid)), max_power_w)
        found = plan_by(
            router,
            places(start, "start"),
            places(goal, "goal"),
            Objective(objective, quantile),
            battery=battery,
            planner=planner,
            neighbours=neighbours,
            refine=refine,
            alternatives=alternatives,
            snap=snap,
            bound=bound,
            time_limit_s=time_limit_s,
            seed=seed,
            progress=progress,
        )
        return PlannedRoute(places.noted(found), router.lattice)

    def tour(
        self,
        stops: Sequence[Point],
        *,
        neighbours: int = 16,
        refine: bool = True,
        snap: bool = False,
        time_limit_s: float = 10.0,
        avoid: Sequence[Sequence[Point]] = (),
        progress: Callable[[float], None] | None = None,
    ) -> PlannedTour:
        """Visit all stops and come home to the first one, in the order that takes least energy.

        Parameters
        ----------
        stops : sequence of points
            World x, y [m]; the first is home.
        neighbours : int, optional
            Directions of a step on the grid: 8, 16 or 32.
        refine : bool, optional
            Whether the legs are improved to any angle.
        snap : bool, optional
            Whether a stop on blocked ground is moved to the nearest free place.
        time_limit_s : float, optional
            For the search of the order [s].
        avoid : sequence of sequence of points, optional
            Areas that no leg may touch: the corners of each, world x, y [m].
        progress : callable, optional
            Called with the share done, 0..1.

        Returns
        -------
        PlannedTour
            Legs with energies in J. Needs the extra `tours`.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `plan`; the two stops are named.
        """
        places = Places(self.lattice.frame)
        router = self.planner.avoiding(places.areas(avoid))
        found = router.tour(
            [places(stop, f"stop {k}") for k, stop in enumerate(stops)],
            neighbours=neighbours,
            refine=refine,
            snap=snap,
            time_limit_s=time_limit_s,
            progress=progress,
        )
        return PlannedTour(places.noted(found), router.lattice)

    def feasibility(
        self,
        route: PlannedRoute | PlannedTour | Sequence[Point],
        *,
        charge: float = 1.0,
        reserve: float = 0.0,
        capacity_wh: float | None = None,
        round_trip: bool = False,
        battery: Battery | None = None,
    ) -> Feasibility:
        """Say whether the battery lasts for a route, how likely that is, and what would make it sure.

        Parameters
        ----------
        route : PlannedRoute, PlannedTour or sequence of points
            What is driven; points are world x, y [m].
        charge : float, optional
            State of charge at the start, 0..1.
        reserve : float, optional
            Share of the capacity that must remain, 0..1.
        capacity_wh : float, optional
            Energy of the full battery [Wh]. By default that of the robot.
        round_trip : bool, optional
            Whether the way back is driven too: the best one back to the start of a planned route, the same points in
            reverse otherwise.
        battery : Battery, optional
            With its charge and reserve, where more is known of it than its energy; the other three then do not count.

        Returns
        -------
        Feasibility
            True in a condition exactly when the battery lasts.

        Raises
        ------
        InputError
            If charge or reserve lie outside 0..1, or a tour, which comes home already, is to be a round trip.
        BlockedError
            If points cross blocked ground.
        """
        warnings = tuple(self.warnings)
        if battery is None:
            full = self.robot.battery_wh if capacity_wh is None else capacity_wh
            battery = Battery(full, charge=charge, reserve=reserve)
        if isinstance(route, PlannedTour):
            if round_trip:
                raise InputError("a tour comes home already: leave out `round_trip`")
            return Feasibility(judge_routes(self.lattice, route.legs, battery), route.legs[0], warnings=warnings)
        if isinstance(route, PlannedRoute):
            back = None
            if round_trip:
                here, there = ((float(p[0]), float(p[1])) for p in (route.points[0], route.points[-1]))
                back = self.planner.plan(there, here).route
            driven = [route.route] if back is None else [route.route, back]
            verdict, volts = judge_routes(self.lattice, driven, battery), self.robot.nominal_voltage_v
            return Feasibility(verdict, route.route, back, warnings, battery, volts)
        points = Places(self.lattice.frame).path(list(route))
        judged = assess(self.planner, battery=battery, path=points, round_trip=round_trip)
        ways = judged.route_out, judged.route_back
        return Feasibility(judged.verdict, *ways, warnings, battery, self.robot.nominal_voltage_v)

    def reach(
        self,
        start: Point,
        *,
        charge: float | Sequence[float] = 1.0,
        reserve: float = 0.0,
        capacity_wh: float | None = None,
        battery: Battery | None = None,
        round_trip: bool = False,
        confidence: float | None = None,
        avoid: Sequence[Sequence[Point]] = (),
        snap: bool = False,
    ) -> ReachMap:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Parameters
        ----------
        start : sequence of float
            World x, y [m].
        charge : float or sequence of float, optional
            State of charge at the start, 0..1; several are answered one by one.
        reserve : float, optional
            Share of the capacity that must remain, 0..1.
        capacity_wh : float, optional
            Energy of the full battery [Wh]. By default that of the robot.
        battery : Battery, optional
            Where more is known of it than its energy; capacity and reserve are its own then.
        round_trip : bool, optional
            Whether it must come back, by the best way back, which is not the way out.
        confidence : float, optional
            With what probability the battery is to last, 0.5..0.99. By default the expected energy decides.
        avoid : sequence of sequence of points, optional
            Areas that no route may touch: the corners of each, world x, y [m].
        snap : bool, optional
            Whether a start on blocked ground is moved to the nearest free place.

        Returns
        -------
        ReachMap
            What is left at every cell [J], with `polygons`, `area_m2`, `margin_at`, `geotiff` and `to_xarray`.

        Raises
        ------
        InputError
            If a share lies outside 0..1, or a confidence is asked of a model that does not know its uncertainty.
        PointError
            If the start lies outside the map.
        BlockedError
            If the start lies on blocked ground, and `snap` is false.
        """
        charges = (charge,) if isinstance(charge, int | float) else tuple(charge)
        full = self.robot.battery_wh if capacity_wh is None else capacity_wh
        given = Battery(full, reserve=reserve) if battery is None else battery
        places = Places(self._whole.frame)
        found = reach_map(
            self.planner.avoiding(places.areas(avoid)),
            places(start, "start"),
            given,
            charges=charges,
            confidence=confidence,
            round_trip=round_trip,
            snap=snap,
        )
        return replace(found, notes=(*places.notes, *found.notes))

    def homeward(
        self,
        position: Point,
        home: Point,
        *,
        battery: Battery,
        path: Sequence[Point] | None = None,
        charging: Sequence[Point] = (),
        confidence: float | None = CONFIDENCE,
    ) -> Homeward:
        """Say until where a robot may follow the rest of its path and still come home: the point of no return.

        Parameters
        ----------
        position : sequence of float or mapping
            Where the robot is, world x, y [m].
        home : sequence of float or mapping
            World x, y [m].
        battery : Battery
            With its charge now.
        path : sequence of points, optional
            The rest of its path.
        charging : sequence of points, optional
            Places to charge, at most 16.
        confidence : float or None, optional
            Probability with which the battery must last; None where the expected energy decides.

        Returns
        -------
        Homeward
            Answers again about the same home come from kept energies, in milliseconds.

        Raises
        ------
        InputError
            If there are too many places to charge, or the map is not in memory.
        PointError
            If a place lies outside the map.
        BlockedError
            If home or a place to charge is on blocked ground, or the path crosses it.
        """
        places = Places(self.lattice.frame)
        return homeward(
            self.planner,
            places(position, "position"),
            places(home, "home"),
            battery,
            path=None if path is None else places.path(list(path)),
            charging=[places(place, f"charging place {k}") for k, place in enumerate(charging)],
            confidence=confidence,
        )

    def speeds(
        self,
        route: PlannedRoute | Route | Sequence[Point],
        heightmap: GroundLike,
        *,
        model: ModelLike = DEFAULT_MODEL,
    ) -> Speeds:
        """Give the cheapest cruising speed of a route, and its energy against its time.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m]. It stays the same at every speed.
        heightmap : Heightmap, str or Path
            What the cost map was made of.
        model : str, Path or Model, optional
            Of the cost map.

        Returns
        -------
        Speeds
            At the speeds that the model learned from, and no others.

        Raises
        ------
        InputError
            If the heightmap is another one, or the model does not know what speed costs.
        """
        if isinstance(route, PlannedRoute):
            route = route.route
        if not isinstance(route, Route):
            route = price_given_path(self.lattice, Places(self.lattice.frame).path(list(route)))
        return speeds_along(route, self.lattice, ground_of(heightmap), find_predictor(model_folder(model)))

    def field(
        self, *, start: Point | None = None, goal: Point | None = None, neighbours: int = 16, snap: bool = False
    ) -> EnergyMap:
        """Give the least energy from a start to every cell, from every cell to a goal, or over every cell between both.

        Parameters
        ----------
        start, goal : sequence of float, optional
            World x, y [m]; at least one of them. With both, the energy of a cell is that of the best route over it.
        neighbours : int, optional
            Directions of a step on the grid: 8, 16 or 32.
        snap : bool, optional
            Whether a place on blocked ground is moved to the nearest free one.

        Returns
        -------
        EnergyMap
            An array [J], with `to_xarray`, `geotiff` and `corridor`. For a map that changes, `planner.replan.Replanner`
            repairs the field instead of making it anew.

        Raises
        ------
        InputError
            Without start and goal.
        PointError
            If a place lies outside the map.
        BlockedError
            If a place lies on blocked ground, and `snap` is false.
        """
        table = move_table(self._whole, neighbours=neighbours)
        places = Places(self._whole.frame)
        ends = [
            None if place is None else end_point(self._whole, *places(place, name), name=name, snap=snap)[0]
            for name, place in (("start", start), ("goal", goal))
        ]
        out = None if ends[0] is None else field_from(self._whole, table, ends[0])
        back = None if ends[1] is None else field_towards(self._whole, table, ends[1][None])
        return energy_map(out, back)

    def at(self, x: float, y: float) -> PointCosts:
        """Say what driving costs at one place, in every direction.

        Parameters
        ----------
        x, y : float
            World x, y [m].

        Returns
        -------
        PointCosts
            Energy per metre [J/m] by heading, and the reason where a heading is blocked.

        Raises
        ------
        PointError
            If the place lies outside the map.
        """
        return costs_at(self.lattice, x, y)

    def plot(self, ax: Axes | None = None, *, view: str | None = None, heading_deg: float | None = None) -> Axes:
        """Draw the energy per metre in colour.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw. By default a new figure is made with pyplot.
        view : str, optional
            "mean" over the headings, "directionality" (dearest minus cheapest heading), or "heading". By default
            "heading" where one is given, "mean" otherwise.
        heading_deg : float, optional
            The heading of the view "heading", clockwise from north.

        Returns
        -------
        matplotlib.axes.Axes
            The map, in metres of its CRS, with a colour bar.

        Raises
        ------
        InputError
            On another view, or without a heading where one is needed.
        """
        from joulemap.service.map_drawing import draw_costmap, new_axes

        ax = new_axes() if ax is None else ax
        view = view or ("mean" if heading_deg is None else "heading")
        drawn = draw_costmap(ax, self._whole, view=view, heading_deg=heading_deg)
        ax.figure.colorbar(drawn.scale, ax=ax, label=drawn.label, extend=drawn.extend)
        ax.set_title(drawn.title)
        if drawn.handles:
            ax.legend(handles=drawn.handles, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
        return ax

    def to_xarray(self) -> Dataset:
        """Return prices, heights and what is blocked with coordinates and units.

        Returns
        -------
        xarray.Dataset
            Dimensions y, x, heading; energy per metre [J/m] is NaN where that heading is blocked.
        """
        from joulemap.planner.lattice_xarray import lattice_dataset

        return lattice_dataset(self._whole)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the map as a folder in zarr format, which `open_costmap` and `xarray.open_zarr` open.

        Parameters
        ----------
        path : str or Path
            Usually NAME.zarr.
        overwrite : bool, optional
            Whether a cost map that is there already is replaced.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        ConflictError
            If something is there already, and `overwrite` is false.
        """
        folder = Path(path)
        if folder.exists() and not overwrite:
            raise ConflictError(
                f"{folder} is there already: choose another name, or say overwrite=True", path=str(path)
            )
        save_lattice(self._whole, folder)
        return folder

    def write_geotiff(self, path: str | Path) -> Path:
        """Write a GeoTIFF: `export` with the format "geotiff".

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.

        Returns
        -------
        Path
            The file.
        """
        return self.export(path, format="geotiff")

    def export(self, path: str | Path, *, format: str | None = None) -> Path:
        """Write the map for another program; the name says for which, like site.yaml (Nav2) or site.cog.tif.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced. A Nav2 map has its image beside it.
        format : str, optional
            A name of `joulemap.service.exports.maps.MAP_FORMATS`; by default the suffix decides.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown.
        """
        return save_map(self._whole, path, format)[0]

    def summary(self) -> dict[str, Any]:
        """Return least, mean and greatest price [J/m], and the share that is blocked, by reason.

        Returns
        -------
        dict
            As the service answers it.
        """
        return summarise(self._whole)

    def _title(self) -> str:
        rows, cols = self.lattice.frame.shape
        spacing = self.lattice.frame.resolution_m
        return f"Cost map of {cols} x {rows} cells of {spacing:g} m, {self.lattice.headings} headings"

    def _rows(self) -> dict[str, str]:
        figures = self.summary()
        price, shares = figures["energy_per_m"], figures["blocked"]
        west, south, east, north = self.bounds
        blocked = ", ".join(f"{share:.1%} {reason}" for reason, share in shares.items() if reason != "free" and share)
        rows = {
            "area": f"x {west:.1f} to {east:.1f}, y {south:.1f} to {north:.1f} m, {self.crs or 'CRS not known'}",
            "robot": f"{self.robot.name}, {self.robot.mass_kg:g} kg, {self.robot.speed_mps:g} m/s",
            "model": str(self.lattice.provenance.get("model", {}).get("name", "not known")),
            "energy per metre": "{min:.1f} to {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "none",
            "blocked": blocked.replace("_", " ") or "nothing",
        }
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<{self._title()}, robot {self.robot.name}>"

    def __str__(self) -> str:
        return text_table(self._title(), self._rows())

    def _repr_html_(self) -> str:
        return html_table(self._title(), self._rows())


def costmap(
    ground: GroundLike,
    robot: RobotLike = None,
    *,
    model: ModelLike = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    progress: Callable[[float], None] | None = None,
) -> CostMap:
    """Make the cost map of a heightmap for a robot.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap, or its file.
    robot : Robot, mapping, str, Path or None, optional
        The robot, its fields, its TOML file, or None for the built-in 35 kg rover.
    model : str, Path or Model, optional
        "default" (the shipped network), "physics", the folder of a trained or calibrated model, or what `train` and
        `calibrate` return.
    spacing_m : float, optional
        Side of a cell [m].
    headings : int, optional
        Number of heading bins, 4 to 360.
    progress : callable, optional
        Called with the share done, 0..1.

    Returns
    -------
    CostMap
        In memory. For maps that do not fit there is the command `joulemap costmap`, which writes tile by tile.

    Raises
    ------
    HeightmapError, RobotError, ModelError
        If a file cannot be used.
    TooLargeError
        If the map would not fit into memory.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> slope = np.tile(np.linspace(0.0, 3.0, 60), (40, 1))
    >>> costs = jm.costmap(jm.heightmap(slope, resolution_m=0.5), model="physics")
    >>> costs.plan((3.0, 10.0), (27.0, 10.0)).energy_j > costs.plan((27.0, 10.0), (3.0, 10.0)).energy_j
    True
    """
    lattice = make_cost_lattice(
        ground_of(ground),
        robot_of(robot),
        model=model_folder(model),
        spacing_m=spacing_m,
        headings=headings,
        progress=progress,
    )
    return CostMap(lattice)


class StoredCostMap(CostMap):
    """A cost map that stays on disk and may be larger than memory: routes and verdicts, within a given memory.

    What needs all of its cells at once (tours, pictures, exports) is refused.

    Parameters
    ----------
    path : str or Path
        Its folder, usually NAME.zarr.
    memory_gb : float, optional
        Most memory of a search [GB].

    Attributes
    ----------
    lattice : CostLattice
        What was read for the questions so far; blocked as unknown elsewhere.
    """

    def __init__(self, path: str | Path, *, memory_gb: float = DEFAULT_MEMORY / 1e9) -> None:
        if not memory_gb > 0.0:
            raise InputError(f"`memory_gb` is {memory_gb}: give a positive number of gigabytes", memory_gb=memory_gb)
        self.stored = StoredPlanner(path, memory_bytes=int(memory_gb * 1e9))

    @property
    def lattice(self) -> CostLattice:  # type: ignore[override]
        """What was read for the questions so far; blocked as unknown elsewhere."""
        return self.stored.lattice

    @property
    def planner(self) -> StoredPlanner:  # type: ignore[override]
        """The planner of this map."""
        return self.stored

    def at(self, x: float, y: float) -> PointCosts:
        """Say what driving costs at one place, as `CostMap.at`.

        Parameters
        ----------
        x, y : float
            World x, y [m].

        Returns
        -------
        PointCosts
            Energy per metre [J/m] by heading, and the reason where a heading is blocked.

        Raises
        ------
        PointError
            If the place lies outside the map.
        """
        self.stored.read_along([(x, y)])
        return super().at(x, y)

    @property
    def _whole(self) -> CostLattice:
        raise InputError("this needs the whole cost map in memory: open it without `memory_gb`")

    def _rows(self) -> dict[str, str]:
        west, south, east, north = self.bounds
        return {
            "area": f"x {west:.1f} to {east:.1f}, y {south:.1f} to {north:.1f} m, {self.crs or 'CRS not known'}",
            "robot": f"{self.robot.name}, {self.robot.mass_kg:g} kg, {self.robot.speed_mps:g} m/s",
            "folder": str(self.stored.stored.path),
        }


def open_costmap(path: str | Path, *, memory_gb: float | None = None) -> CostMap:
    """Open a cost map that `CostMap.save` or the command `joulemap costmap` wrote.

    Parameters
    ----------
    path : str or Path
        Its folder, usually NAME.zarr.
    memory_gb : float, optional
        Plan on the map from disk, within so much memory [GB]; it may be of any size then. By default it is read as a
        whole.

    Returns
    -------
    CostMap
        The same to the bit; a `StoredCostMap` where `memory_gb` is given.

    Raises
    ------
    InputError
        If the folder is no cost map.
    """
    return CostMap(load_lattice(path)) if memory_gb is None else StoredCostMap(path, memory_gb=memory_gb)
