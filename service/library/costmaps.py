"""The cost map of a Python user: made of a heightmap or opened from a folder, its questions, and what it gives out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.battery import Battery
from joulemap.model.errors import ConflictError, InputError
from joulemap.model.robot import Robot
from joulemap.planner.areas.energy_map import EnergyMap
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.folder import save_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.on_disk.tiled_table import DEFAULT_MEMORY
from joulemap.planner.route import Route, in_sequence
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.analysis.cost_lattices import make_cost_lattice, summarise
from joulemap.service.analysis.feasibility import assess, judge_routes
from joulemap.service.analysis.homeward import Homeward
from joulemap.service.analysis.point_costs import PointCosts
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.exports.maps import save_map
from joulemap.service.library.drive import Drive
from joulemap.service.library.feasibility import Feasibility
from joulemap.service.library.planned import PlannedRoute, PlannedTour
from joulemap.service.library.shown import Shown
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.places.coordinates import PlaceLike
from joulemap.service.places.places import Places
from joulemap.service.questions import at, charging, field, homeward, matrix, path, reach, tour
from joulemap.service.questions.asking import asks
from joulemap.service.questions.charging import ChargedWay, ChargingRequest
from joulemap.service.questions.costmap import CostmapCells
from joulemap.service.questions.drive import DriveRequest
from joulemap.service.questions.field import FieldRequest
from joulemap.service.questions.given import battery_with, checked
from joulemap.service.questions.homeward import ReturnRequest
from joulemap.service.questions.matrix import EnergyMatrix, MatrixRequest
from joulemap.service.questions.parts import BatteryIn, battery_of
from joulemap.service.questions.path import PathRequest
from joulemap.service.questions.reach import ReachRequest
from joulemap.service.questions.speeds import SpeedsRequest
from joulemap.service.questions.tour import TourRequest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

    from joulemap.service.analysis.speeds import Speeds
    from joulemap.service.library.heightmaps import GroundLike, RobotLike
    from joulemap.service.library.models import ModelLike


Point = PlaceLike
"""World x, y [m] in the CRS of the map; or latitude, longitude, see `service.places.coordinates.world_point`."""


class CostMap(Shown):
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

    def __getstate__(self) -> dict[str, Any]:
        """Leave the planner out of copies: it has locks, and is made again when it is needed."""
        return {name: value for name, value in self.__dict__.items() if name != "planner"}

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

    @asks(PathRequest)
    def plan(self, wanted: PathRequest, *, progress: Callable[[float], None] | None = None) -> PlannedRoute:
        """Find the route of least energy, and the shortest one beside it.

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
        found = path.ask(self.planner, wanted, progress=progress)
        return PlannedRoute(found.plan, found.lattice)

    @asks(TourRequest, "battery")
    def tour(self, wanted: TourRequest, *, progress: Callable[[float], None] | None = None) -> PlannedTour:
        """Visit all stops, in the order that takes least energy or as given, and come home unless it is one way.

        Returns
        -------
        PlannedTour
            Legs with energies in J. Needs the extra `tours`, unless `in_order`.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `plan`; the two stops are named.
        """
        found = tour.ask(self.planner, wanted, progress=progress)
        return PlannedTour(found.trip, found.lattice)

    @asks(MatrixRequest)
    def matrix(self, wanted: MatrixRequest, *, progress: Callable[[float], None] | None = None) -> EnergyMatrix:
        """Say what it takes to drive from each start to each goal, by one search for each start or goal.

        Returns
        -------
        EnergyMatrix
            Arrays with a row for each start; infinite where there is no way, with the reason.

        Raises
        ------
        PointError
            If a place lies outside the map.
        """
        return matrix.ask(self.planner, wanted, progress=progress)

    @asks(ChargingRequest)
    def charging(self, wanted: ChargingRequest, *, progress: Callable[[float], None] | None = None) -> ChargedWay:
        """Find the cheapest way that never falls below the reserve, charging where it may.

        Returns
        -------
        ChargedWay
            Its legs with what is charged before each; without legs, why there is no such way.

        Raises
        ------
        PointError
            If a place lies outside the map.
        """
        return charging.ask(self.planner, wanted, progress=progress)

    def feasibility(
        self,
        route: PlannedRoute | PlannedTour | Sequence[Point],
        *,
        charge: float | None = None,
        reserve: float | None = None,
        capacity_wh: float | None = None,
        round_trip: bool = False,
        battery: Battery | Mapping[str, Any] | None = None,
    ) -> Feasibility:
        """Say whether the battery lasts for a route, how likely that is, and what would make it sure.

        Parameters
        ----------
        route : PlannedRoute, PlannedTour or sequence of points
            What is driven; points are world x, y [m].
        charge : float, optional
            State of charge at the start, 0..1. By default 1.
        reserve : float, optional
            Share of the capacity that must remain, 0..1. By default 0.
        capacity_wh : float, optional
            Energy of the full battery [Wh]. By default that of the robot.
        round_trip : bool, optional
            Whether the way back is driven too: the best one back to the start of a planned route, the same points in
            reverse otherwise.
        battery : Battery or mapping, optional
            With its charge and reserve, where more is known of it than its energy. The other three must not say
            otherwise.

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
        known = battery_with(battery, charge=charge, reserve=reserve, capacity_wh=capacity_wh)
        battery = battery_of(checked(BatteryIn, known or {}), self.robot)
        if isinstance(route, PlannedTour):
            if round_trip:
                raise InputError("a tour comes home already: leave out `round_trip`")
            return Feasibility(judge_routes(self.lattice, route.legs, battery), route.legs[0], warnings=warnings)
        if isinstance(route, PlannedRoute):
            driven = [route.route]
            if round_trip:
                here, there = ((float(p[0]), float(p[1])) for p in (route.points[0], route.points[-1]))
                driven += [self.planner.plan(there, here, self.planner.on_from(route.route)).route]
            both = in_sequence(driven, self.robot.turn_j_per_rad)
            verdict, volts = judge_routes(self.lattice, both, battery), self.robot.nominal_voltage_v
            return Feasibility(verdict, both[0], both[1] if round_trip else None, warnings, battery, volts)
        points = Places(self.lattice.frame).path(list(route))
        judged = assess(self.planner, battery=battery, path=points, round_trip=round_trip)
        ways = judged.route_out, judged.route_back
        return Feasibility(judged.verdict, *ways, warnings, battery, self.robot.nominal_voltage_v)

    def drive(self, route: PlannedRoute | Route | Sequence[Point], *, battery: Battery | None = None) -> Drive:
        """Follow a drive along a route: what the log says while driving corrects the forecast of the rest.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m].
        battery : Battery, optional
            At the start; by default the robot's own, full and without a reserve.

        Returns
        -------
        Drive
            With `update` and `forecast`.

        Raises
        ------
        InputError
            If the route is no path, is shorter than 1 cm or longer than 20 km, or the battery is none.
        """
        if isinstance(route, PlannedRoute):
            route = route.route
        path = route.points[:, :2] if isinstance(route, Route) else route
        wanted = checked(DriveRequest, {"path": path, "battery": battery})
        if not isinstance(battery, Battery):
            battery = battery_of(wanted.battery, self.robot)
        if isinstance(route, Route):
            return Drive(self.lattice, route, battery)
        return Drive.along(self.lattice, Places(self.lattice.frame).path(wanted.path), battery)

    def speeds(
        self,
        route: PlannedRoute | Route | Sequence[Point],
        heightmap: GroundLike,
        *,
        model: ModelLike = DEFAULT_MODEL,
        by_stretch: bool = False,
        deadline_s: float | None = None,
    ) -> Speeds:
        """Give the cheapest cruising speed of a route, its energy against its time, and a speed for each stretch.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m]. It stays the same at every speed.
        heightmap : Heightmap, str or Path
            What the cost map was made of.
        model : str, Path or Model, optional
            Of the cost map.
        by_stretch : bool, optional
            Also find a speed for each stretch, of least energy; changes of speed are paid for.
        deadline_s : float, optional
            Time in which the route is driven [s]; gives a speed for each stretch.

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
        ends = route.points[[0, -1], :2] if isinstance(route, Route) else route
        wanted = checked(SpeedsRequest, {"path": ends, "by_stretch": by_stretch, "deadline_s": deadline_s})
        if not isinstance(route, Route):
            route = price_given_path(self.lattice, Places(self.lattice.frame).path(list(route)))
        # readers and models load slowly, and most questions to a cost map need none
        from joulemap.service.analysis.speeds import speeds_along
        from joulemap.service.library.heightmaps import ground_of
        from joulemap.service.library.models import predictor_of

        made_of, predictor = ground_of(heightmap), predictor_of(model)
        deadline_s = wanted.deadline_s
        return speeds_along(
            route, self.lattice, made_of, predictor, by_stretch=wanted.by_stretch, deadline_s=deadline_s
        )

    @asks(ReachRequest, "charges", complete=False)
    def reach(
        self,
        wanted: dict[str, Any],
        *,
        charge: float | Sequence[float] | None = None,
        reserve: float | None = None,
        capacity_wh: float | None = None,
    ) -> ReachMap:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Parameters
        ----------
        charge : float or sequence of float, optional
            State of charge at the start, 0..1, by default that of the battery; several are answered one by one.
        reserve, capacity_wh : float, optional
            As the fields of `battery`, which then must not say otherwise.

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
        charges = [charge] if isinstance(charge, int | float) else charge
        battery = battery_with(wanted.pop("battery", None), reserve=reserve, capacity_wh=capacity_wh)
        return reach.ask(self.planner, ReachRequest.of(**wanted, charges=charges, battery=battery))

    @asks(ReturnRequest)
    def homeward(self, wanted: ReturnRequest) -> Homeward:
        """Say until where a robot may follow the rest of its path and still come home: the point of no return.

        Returns
        -------
        Homeward
            Answers again about the same home come from kept energies, in milliseconds.

        Raises
        ------
        InputError
            If there are too many places to charge, a confidence is given without odds, or the map is not in memory.
        PointError
            If a place lies outside the map.
        BlockedError
            If home or a place to charge is on blocked ground, or the path crosses it.
        """
        return homeward.ask(self.planner, wanted)

    @asks(FieldRequest, "within_percent")
    def field(self, wanted: FieldRequest) -> EnergyMap:
        """Give the least energy from a start to every cell, from every cell to a goal, or over every cell between both.

        Returns
        -------
        EnergyMap
            An array [J], with `to_xarray`, `geotiff` and `corridor`. With start and goal, the energy of a cell is that
            of the best route over it. For a map that changes, `planner.replan.Replanner` repairs the field instead of
            making it anew.

        Raises
        ------
        InputError
            Without start and goal.
        PointError
            If a place lies outside the map.
        BlockedError
            If a place lies on blocked ground, and `snap` is false.
        NoRouteError
            If no route joins the two.
        """
        return field.ask(self.planner, wanted).energies

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
        return at.ask(self.planner, at.AtRequest.of(place=(x, y))).costs

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
        from joulemap.service.render.energy_colours import draw_costmap
        from joulemap.service.render.raster_shading import new_axes

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
        from joulemap.planner.lattice.xarray_dataset import lattice_dataset

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

    def export(self, path: str | Path, *, format: str | None = None, origin: Sequence[float] | None = None) -> Path:
        """Write the map for another program; the name says for which, like site.yaml (Nav2) or site.cog.tif.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced. A Nav2 map has its image beside it.
        format : str, optional
            A name of `joulemap.service.exports.maps.MAP_FORMATS`; by default the suffix decides.
        origin : tuple of float, optional
            Of Nav2 formats: world x, y of the place that gets the coordinates 0, 0 [m].

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown, or has an origin of its own.
        """
        return save_map(self._whole, path, format, origin=origin)[0]

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


@asks(CostmapCells, complete=False)
def costmap(
    ground: GroundLike,
    robot: RobotLike = None,
    *,
    model: ModelLike = DEFAULT_MODEL,
    wanted: dict[str, Any],
    progress: Callable[[float], None] | None = None,
) -> CostMap:
    """Make the cost map of a heightmap for a robot.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap, or its file.
    model : str, Path, Model, callable or object with `predict`, optional
        "default" (the shipped network), "physics", the folder of a trained or calibrated model, or what `train` and
        `calibrate` return. Or a model of your own, which answers traction [J/m] without idle power: a function of the
        slope along, the slope across (rise over run), the roughness [m] and the speed [m/s], arrays (n,); or an object
        whose `predict` takes heights, (n, 32, 32) [m], of the metre ahead and headings, (n,) [rad].

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
    >>> mine = lambda along, across, roughness, speed: 30.0 + 400.0 * along + 900.0 * roughness
    >>> jm.costmap(jm.heightmap(slope, resolution_m=0.5), model=mine).plan((3.0, 10.0), (27.0, 10.0)).length_m
    24.0
    """
    # readers load slowly, and a cost map that is there already needs none
    from joulemap.service.library.heightmaps import ground_of, robot_of
    from joulemap.service.library.models import predictor_of

    how = {**wanted, "model": predictor_of(model), "progress": progress}
    return CostMap(make_cost_lattice(ground_of(ground), robot_of(robot), **how))


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
        self._memory_gb = memory_gb
        self.stored = StoredPlanner(path, memory_bytes=int(memory_gb * 1e9))

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the folder again: an open one is no part of a copy."""
        return _opened, (str(self.stored.stored.path), self._memory_gb)

    @property
    def lattice(self) -> CostLattice:  # type: ignore[override]
        """What was read for the questions so far; blocked as unknown elsewhere."""
        return self.stored.lattice

    @property
    def planner(self) -> StoredPlanner:
        """The planner of this map."""
        return self.stored

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


def _opened(path: str, memory_gb: float) -> StoredCostMap:
    return StoredCostMap(path, memory_gb=memory_gb)


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
    NotFoundError
        If there is no such folder.
    """
    return CostMap(load_lattice(path)) if memory_gb is None else StoredCostMap(path, memory_gb=memory_gb)
