"""What a plan is to a Python user: a route with its numbers, its picture and its files; and the verdict on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.planner.budget import Verdict, battery_along
from joulemap.planner.lattice import CostLattice
from joulemap.planner.plan import Plan, RoundTrip
from joulemap.planner.route import Profile, Route
from joulemap.service.exports.geojson import geojson_document
from joulemap.service.exports.routes import route_file, route_format_of
from joulemap.service.exports.track import Track, track_of_plan, track_of_tour
from joulemap.service.library.html import html_table, text_table
from joulemap.service.objectives import Weighed
from joulemap.service.words import duration_words, energy_words, route_words, saving_words, verdict_words

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes

    from joulemap.model.battery import Battery
    from joulemap.planner.battery_trace import BatteryTrace
    from joulemap.planner.course import Course


@dataclass(frozen=True, eq=False, repr=False)
class PlannedRoute:
    """The energy-optimal route between two places, and the shortest one beside it.

    Attributes
    ----------
    found : Plan
        The planner's answer.
    lattice : CostLattice
        The cost map that it was planned on.
    """

    found: Plan
    lattice: CostLattice

    @property
    def route(self) -> Route:
        """The route of least energy."""
        return self.found.route

    @property
    def shortest(self) -> Route:
        """The shortest route within the same limits, at the same prices."""
        return self.found.shortest

    @property
    def alternatives(self) -> tuple[Route, ...]:
        """Other good routes, cheapest first."""
        return self.found.others

    @property
    def points(self) -> NDArray[np.float64]:
        """World x, y, z of the corners, (n, 3) [m]."""
        return self.route.points

    @property
    def profile(self) -> Profile:
        """Distance, height, heading and energy, piece by piece."""
        return self.route.profile

    @property
    def energy_j(self) -> float:
        """Energy drawn from the battery [J]."""
        return self.route.energy_j

    @property
    def length_m(self) -> float:
        """Horizontal length [m]."""
        return self.route.length_m

    @property
    def duration_s(self) -> float:
        """Driving time at the robot's cruising speed, without turns on the spot [s]."""
        return self.route.duration_s

    @property
    def saving_j(self) -> float:
        """Energy saved against the shortest route [J], never negative."""
        return self.found.saving_j

    @property
    def bound_j(self) -> float | None:
        """Proven lower bound of the energy of every route between the two places [J]; None where nothing is known."""
        return self.found.bound_j

    @property
    def gap(self) -> float | None:
        """By which share of the bound the route may cost more than the best one; None without a bound above 0."""
        return self.found.gap

    @property
    def objective(self) -> Weighed | None:
        """How well the route does by what it was chosen by; None for the least expected energy."""
        found = self.found.details.get("objective")
        return None if found is None else Weighed(**found)

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return list(self.lattice.provenance.get("warnings", []))

    @property
    def notes(self) -> list[str]:
        """What the user should know about this route."""
        return self.route.notes

    def plot(self, ax: Axes | None = None, *, shortest: bool = True) -> Axes:
        """Draw the route on the terrain.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw. By default a new figure is made with pyplot.
        shortest : bool, optional
            Whether the shortest route is drawn beside it.

        Returns
        -------
        matplotlib.axes.Axes
            The map, in metres of its CRS.
        """
        from joulemap.service.map_drawing import draw_lattice_ground, draw_routes, new_axes

        ax = new_axes() if ax is None else ax
        patches = draw_lattice_ground(ax, self.lattice)
        draw_routes(ax, self.route, self.shortest if shortest else None, alternatives=self.alternatives)
        handles = [*ax.get_legend_handles_labels()[0], *patches]
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False, fontsize=9)
        return ax

    def plot_profile(self, ax: Axes | None = None, *, quantity: str = "energy") -> Axes:
        """Draw energy or height over the distance along the route.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw. By default a new figure is made with pyplot.
        quantity : str, optional
            "energy" [kJ] since the start, or "elevation" [m].

        Returns
        -------
        matplotlib.axes.Axes
            The profile, in metres along the path.

        Raises
        ------
        InputError
            On another quantity.
        """
        from joulemap.service.map_drawing import OPTIMAL, SHORTEST, draw_profile, new_axes

        if quantity not in ("energy", "elevation"):
            raise InputError(f"`quantity` is {quantity!r}: give 'energy' or 'elevation'", quantity=quantity)
        ax = new_axes() if ax is None else ax
        for route, colour, name in ((self.shortest, SHORTEST, "shortest"), (self.route, OPTIMAL, "energy-optimal")):
            draw_profile(ax, route, quantity=quantity, colour=colour, label=name)
        ax.set_xlabel("distance along the path [m]")
        ax.legend(frameon=False)
        return ax

    @property
    def track(self) -> Track:
        """The routes as what files are written from."""
        return track_of_plan(self.found, self.lattice, warnings=self.warnings)

    def to_geojson(self, *, coordinates: str = "wgs84") -> dict[str, Any]:
        """Return both routes, and the alternatives, as GeoJSON.

        Parameters
        ----------
        coordinates : str, optional
            "wgs84" (longitude, latitude [degrees], as RFC 7946 wants them) or "map" (x, y [m] in the CRS of the map,
            which the member `crs` names).

        Returns
        -------
        dict
            A FeatureCollection of lines with heights.

        Raises
        ------
        InputError
            If the map has no CRS, and degrees are wanted.
        """
        return geojson_document(self.track, coordinates=coordinates)

    def save(self, path: str | Path, *, format: str | None = None, coordinates: str | None = None) -> Path:
        """Write the route for another program; the name says for which, like route.gpx or route.plan.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.
        format : str, optional
            A name of `joulemap.service.exports.routes.ROUTE_FORMATS`; by default the suffix decides.
        coordinates : str, optional
            Of GeoJSON, as for `to_geojson`.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown, or the map has no CRS and the format needs degrees.
        """
        return _save(self.track, path, format, coordinates)

    def to_geodataframe(self) -> GeoDataFrame:
        """Return the routes as a table with a geometry, a row each. Needs the extra `geo`.

        Returns
        -------
        geopandas.GeoDataFrame
            Columns `kind`, `energy_j` [J], `length_m` [m], `duration_s` [s] and `geometry` in the CRS of the map.

        Raises
        ------
        InputError
            If geopandas is not installed.
        """
        return _geodataframe(
            [
                ("energy_optimal", self.route),
                ("shortest", self.shortest),
                *(("alternative", other) for other in self.alternatives),
            ],
            self.route.crs,
        )

    def _rows(self) -> dict[str, str]:
        route = _numbers(self.route)
        rows = {"energy-optimal": route_words(route), "shortest": route_words(_numbers(self.shortest))}
        rows |= {f"alternative {k}": route_words(_numbers(r)) for k, r in enumerate(self.alternatives, 1)}
        rows["saved"] = saving_words(route, _numbers(self.shortest))
        rows |= {"note": "; ".join(self.notes)} if self.notes else {}
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<PlannedRoute: {route_words(_numbers(self.route))}>"

    def __str__(self) -> str:
        return text_table(f"Route, found by {self.found.planner}", self._rows())

    def _repr_html_(self) -> str:
        return html_table(f"Route, found by {self.found.planner}", self._rows())


@dataclass(frozen=True, eq=False, repr=False)
class PlannedTour:
    """A round trip over several stops in the order that takes least energy.

    Attributes
    ----------
    found : RoundTrip
        The planner's answer.
    lattice : CostLattice
        The cost map that it was planned on.
    """

    found: RoundTrip
    lattice: CostLattice

    @property
    def legs(self) -> tuple[Route, ...]:
        """From each stop to the next, and home from the last."""
        return self.found.legs

    @property
    def order(self) -> tuple[int, ...]:
        """Which stop is visited when, home (0) first."""
        return self.found.order

    @property
    def energy_j(self) -> float:
        """Energy of all legs [J]."""
        return self.found.energy_j

    @property
    def length_m(self) -> float:
        """Horizontal length of all legs [m]."""
        return sum(leg.length_m for leg in self.legs)

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return list(self.lattice.provenance.get("warnings", []))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the tour on the terrain.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw. By default a new figure is made with pyplot.

        Returns
        -------
        matplotlib.axes.Axes
            The map, in metres of its CRS.
        """
        from joulemap.service.map_drawing import OPTIMAL, draw_lattice_ground, new_axes

        ax = new_axes() if ax is None else ax
        draw_lattice_ground(ax, self.lattice)
        for leg in self.legs:
            ax.plot(*leg.points[:, :2].T, color=OPTIMAL, lw=2.5, zorder=3)
        for number, (leg, stop) in enumerate(zip(self.legs, self.order, strict=True)):
            ax.plot(*leg.points[0, :2], "o", ms=15, mfc="white", mec=OPTIMAL, zorder=4)
            name = "home" if number == 0 else str(stop)
            ax.annotate(name, (leg.points[0, 0], leg.points[0, 1]), ha="center", va="center", fontsize=7, zorder=5)
        return ax

    @property
    def track(self) -> Track:
        """The legs as what files are written from."""
        return track_of_tour(self.found, self.lattice, warnings=self.warnings)

    def to_geojson(self, *, coordinates: str = "wgs84") -> dict[str, Any]:
        """Return the legs as GeoJSON.

        Parameters
        ----------
        coordinates : str, optional
            "wgs84" or "map", as for `PlannedRoute.to_geojson`.

        Returns
        -------
        dict
            A FeatureCollection with a line for each leg.

        Raises
        ------
        InputError
            If the map has no CRS, and degrees are wanted.
        """
        return geojson_document(self.track, coordinates=coordinates)

    def save(self, path: str | Path, *, format: str | None = None, coordinates: str | None = None) -> Path:
        """Write the tour for another program, as `PlannedRoute.save`.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.
        format : str, optional
            By default the suffix decides.
        coordinates : str, optional
            Of GeoJSON.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown, or the map has no CRS and the format needs degrees.
        """
        return _save(self.track, path, format, coordinates)

    def to_geodataframe(self) -> GeoDataFrame:
        """Return the legs as a table with a geometry, a row each. Needs the extra `geo`.

        Returns
        -------
        geopandas.GeoDataFrame
            Columns `kind`, `energy_j` [J], `length_m` [m], `duration_s` [s] and `geometry` in the CRS of the map.

        Raises
        ------
        InputError
            If geopandas is not installed.
        """
        return _geodataframe([("leg", leg) for leg in self.legs], self.legs[0].crs)

    def __repr__(self) -> str:
        return f"<PlannedTour: {len(self.order)} stops, {self.length_m:.1f} m, {energy_words(self.energy_j)}>"


@dataclass(frozen=True, eq=False, repr=False)
class Feasibility:
    """Whether the battery lasts for a task. It is true in a condition exactly when it does.

    Attributes
    ----------
    verdict : Verdict
        Energy, margin and charge at the end.
    route_out : Route
        The way there.
    route_back : Route or None
        The way back of a round trip.
    warnings : tuple of str
        Where map or robot lie outside what the model learned.
    battery : Battery or None
        That was judged; None for a tour.
    nominal_voltage_v : float
        Of the robot [V].
    """

    verdict: Verdict
    route_out: Route
    route_back: Route | None = None
    warnings: tuple[str, ...] = ()
    battery: Battery | None = None
    nominal_voltage_v: float = Robot.nominal_voltage_v

    @property
    def feasible(self) -> bool:
        """Whether the battery lasts, with its reserve."""
        return self.verdict.feasible

    @property
    def energy_j(self) -> float:
        """Energy that the task takes [J]."""
        return self.verdict.energy_j

    @property
    def margin_j(self) -> float:
        """Energy that is left above the reserve [J]; 0 when it does not last."""
        return self.verdict.margin_j

    @property
    def shortfall_j(self) -> float:
        """Energy that is missing [J]; 0 when it lasts."""
        return self.verdict.shortfall_j

    @property
    def charge_at_end(self) -> float:
        """State of charge after the task, 0..1."""
        return self.verdict.charge_at_end

    @property
    def class_(self) -> str:
        """One of "yes" (95 % likely, or more), "likely" (2/3), "marginal" (1/3) and "no"."""
        return self.verdict.verdict

    @property
    def text(self) -> str:
        """The verdict in one sentence, with what would make it a yes."""
        return self.verdict.verdict_text

    def battery_along(self) -> tuple[Course, BatteryTrace]:
        """Return the battery piece by piece, with a plain pack's values where nothing else is known.

        Returns
        -------
        course : Course
            The pieces of the way, with distance [m], time [s] and energy [J].
        trace : BatteryTrace
            State of charge, voltage [V] and power [W] of each.

        Raises
        ------
        InputError
            If the task is a tour, or the cut-off voltage is above every voltage that the battery has.
        """
        if self.battery is None:
            raise InputError("a tour has no trace of the battery: ask for one of its legs")
        routes = [route for route in (self.route_out, self.route_back) if route is not None]
        return battery_along(routes, self.battery, self.nominal_voltage_v)

    @property
    def probability(self) -> float | None:
        """Probability that the battery lasts, 0.01..0.99; None where the model does not know its own uncertainty."""
        return self.verdict.probability

    def __bool__(self) -> bool:
        return self.verdict.feasible

    def __repr__(self) -> str:
        return f"<Feasibility: {verdict_words(self.verdict)}>"

    def __str__(self) -> str:
        return "\n".join([verdict_words(self.verdict), self.text, *(f"Warning: {words}" for words in self.warnings)])

    def _repr_html_(self) -> str:
        routes = {"way out": self.route_out, "way back": self.route_back}
        rows = {name: route_words(_numbers(route)) for name, route in routes.items() if route is not None}
        rows["time"] = duration_words(sum(r.duration_s for r in routes.values() if r is not None))
        rows |= {"warning": "; ".join(self.warnings)} if self.warnings else {}
        return html_table(verdict_words(self.verdict), rows)


def _save(track: Track, path: str | Path, format: str | None, coordinates: str | None) -> Path:
    file = Path(path)
    file.write_bytes(route_file(track, route_format_of(file, format), coordinates=coordinates))
    return file


def _numbers(route: Route) -> dict[str, float]:
    return {"energy_j": route.energy_j, "length_m": route.length_m, "duration_s": route.duration_s}


def _geodataframe(routes: Sequence[tuple[str, Route]], crs: str | None) -> GeoDataFrame:
    try:
        from geopandas import GeoDataFrame
        from shapely import LineString
    except ImportError as error:
        raise InputError("a GeoDataFrame needs geopandas: pip install 'joulemap[geo]'") from error
    rows = [{"kind": kind, **_numbers(route)} for kind, route in routes]
    lines = []
    for _, route in routes:  # a line has two points at least
        points = route.points if len(route.points) > 1 else np.repeat(route.points, 2, axis=0)
        lines.append(LineString(points))
    return GeoDataFrame(rows, geometry=lines, crs=crs)
