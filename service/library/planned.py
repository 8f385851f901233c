"""What a Python user gets of a plan: a route or a tour, with its files and pictures."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.planner.answers import Plan, RoundTrip
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Profile, Route
from joulemap.service.analysis.objectives import Weighed
from joulemap.service.exports.formats import format_of
from joulemap.service.exports.geojson import geojson_document
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from joulemap.service.exports.track import Track, track_of_plan, track_of_tour
from joulemap.service.library.shown import Shown
from joulemap.service.words import energy_words, route_words, saving_words

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False, repr=False)
class Planned:
    """What was planned on a cost map: its warnings and its files."""

    found: Plan | RoundTrip
    lattice: CostLattice

    @property
    @abstractmethod
    def track(self) -> Track:
        """What files are written from."""

    @property
    @abstractmethod
    def _lines(self) -> list[tuple[str, Route]]:
        """The routes with what each of them is."""

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return list(self.lattice.provenance.get("warnings", []))

    def to_geojson(self, *, coordinates: str = "wgs84") -> dict[str, Any]:
        """Return what was planned as GeoJSON.

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

    def to_geodataframe(self) -> GeoDataFrame:
        """Return the routes, or the legs of a tour, as a table with a geometry, a row each. Needs the extra `geo`.

        Returns
        -------
        geopandas.GeoDataFrame
            Columns `kind`, `energy_j` [J], `length_m` [m], `duration_s` [s] and `geometry` in the CRS of the map.

        Raises
        ------
        InputError
            If geopandas is not installed.
        """
        try:
            from geopandas import GeoDataFrame
            from shapely import LineString
        except ImportError as error:
            raise InputError("a GeoDataFrame needs geopandas: pip install 'joulemap[geo]'") from error
        rows = [{"kind": kind, **route_numbers(route)} for kind, route in self._lines]
        lines = []
        for _, route in self._lines:  # a line has two points at least
            points = route.points if len(route.points) > 1 else np.repeat(route.points, 2, axis=0)
            lines.append(LineString(points))
        return GeoDataFrame(rows, geometry=lines, crs=self.lattice.frame.crs)

    def save(
        self,
        path: str | Path,
        *,
        format: str | None = None,
        coordinates: str | None = None,
        origin: str | Sequence[float] | None = None,
    ) -> Path:
        """Write what was planned for another program; the name says for which, like route.gpx or route.plan.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.
        format : str, optional
            A name of `joulemap.service.exports.routes.ROUTE_FORMATS`; by default the suffix decides.
        coordinates : str, optional
            Of GeoJSON, as for `to_geojson`.
        origin : tuple of float or "start", optional
            Of formats for ROS: world x, y of the place that gets the coordinates 0, 0 [m]; or the start.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown, or the map has no CRS and the format needs degrees.
        """
        file = Path(path)
        chosen = format_of(ROUTE_FORMATS, file, format)
        file.write_bytes(RouteFile(chosen, coordinates, origin).written(self.track))
        return file


def route_numbers(route: Route) -> dict[str, float]:
    """Return the numbers of a route that words and tables give.

    Result: `energy_j` [J], `length_m` [m] and `duration_s` [s].
    """
    return {"energy_j": route.energy_j, "length_m": route.length_m, "duration_s": route.duration_s}


@dataclass(frozen=True, eq=False, repr=False)
class PlannedRoute(Shown, Planned):
    """The energy-optimal route between two places, and the shortest one beside it.

    Attributes
    ----------
    found : Plan
        The planner's answer.
    lattice : CostLattice
        The cost map that it was planned on.
    """

    found: Plan

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
        from joulemap.service.render.ground_drawing import draw_lattice_ground
        from joulemap.service.render.pictures import draw_routes
        from joulemap.service.render.raster_shading import new_axes

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
        from joulemap.service.render.pictures import draw_profile
        from joulemap.service.render.raster_shading import OPTIMAL, SHORTEST, new_axes

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

    @property
    def _lines(self) -> list[tuple[str, Route]]:
        others = [("alternative", other) for other in self.alternatives]
        return [("energy_optimal", self.route), ("shortest", self.shortest), *others]

    def _title(self) -> str:
        return f"Route, found by {self.found.planner}"

    def _rows(self) -> dict[str, str]:
        route = route_numbers(self.route)
        rows = {"energy-optimal": route_words(route), "shortest": route_words(route_numbers(self.shortest))}
        rows |= {f"alternative {k}": route_words(route_numbers(r)) for k, r in enumerate(self.alternatives, 1)}
        rows["saved"] = saving_words(route, route_numbers(self.shortest))
        rows |= {"note": "; ".join(self.notes)} if self.notes else {}
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<PlannedRoute: {route_words(route_numbers(self.route))}>"


@dataclass(frozen=True, eq=False, repr=False)
class PlannedTour(Planned):
    """A tour over several stops, in the order that takes least energy or as given.

    Attributes
    ----------
    found : RoundTrip
        The planner's answer.
    lattice : CostLattice
        The cost map that it was planned on.
    """

    found: RoundTrip

    @property
    def legs(self) -> tuple[Route, ...]:
        """From each stop to the next, and home from the last unless it is one way."""
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
        from joulemap.service.render.ground_drawing import draw_lattice_ground
        from joulemap.service.render.raster_shading import OPTIMAL, new_axes

        ax = new_axes() if ax is None else ax
        draw_lattice_ground(ax, self.lattice)
        for leg in self.legs:
            ax.plot(*leg.points[:, :2].T, color=OPTIMAL, lw=2.5, zorder=3)
        for leg, (_, stop) in zip(self.legs, self.found.hops, strict=True):
            places = {str(stop): leg.points[-1, :2]} | ({"home": leg.points[0, :2]} if leg is self.legs[0] else {})
            for name, place in places.items():
                if name != "0":
                    ax.plot(*place, "o", ms=15, mfc="white", mec=OPTIMAL, zorder=4)
                    ax.annotate(name, (place[0], place[1]), ha="center", va="center", fontsize=7, zorder=5)
        return ax

    @property
    def track(self) -> Track:
        """The legs as what files are written from."""
        return track_of_tour(self.found, self.lattice, warnings=self.warnings)

    @property
    def _lines(self) -> list[tuple[str, Route]]:
        return [("leg", leg) for leg in self.legs]

    def __repr__(self) -> str:
        return f"<PlannedTour: {len(self.order)} stops, {self.length_m:.1f} m, {energy_words(self.energy_j)}>"
