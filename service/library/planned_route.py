"""A planned route as a Python user has it: its numbers, its picture and its files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.planner.answers import Plan
from joulemap.planner.route import Profile, Route
from joulemap.service.analysis.objectives import Weighed
from joulemap.service.exports.track import Track, track_of_plan
from joulemap.service.library.route_output import Planned, geodataframe, route_numbers
from joulemap.service.library.shown import Shown
from joulemap.service.words import route_words, saving_words

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes


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
        from joulemap.service.render.map_style import new_axes
        from joulemap.service.render.route_drawing import draw_routes

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
        from joulemap.service.render.map_style import OPTIMAL, SHORTEST, new_axes
        from joulemap.service.render.route_drawing import draw_profile

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
        return geodataframe(
            [
                ("energy_optimal", self.route),
                ("shortest", self.shortest),
                *(("alternative", other) for other in self.alternatives),
            ],
            self.route.crs,
        )

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
