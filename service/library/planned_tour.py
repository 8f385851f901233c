"""A planned tour as a Python user has it: its legs, its picture and its files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from joulemap.planner.answers import RoundTrip
from joulemap.planner.route import Route
from joulemap.service.exports.track import Track, track_of_tour
from joulemap.service.library.route_output import Planned, geodataframe
from joulemap.service.words import energy_words

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes


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
        from joulemap.service.render.map_style import OPTIMAL, new_axes

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
        return geodataframe([("leg", leg) for leg in self.legs], self.legs[0].crs)

    def __repr__(self) -> str:
        return f"<PlannedTour: {len(self.order)} stops, {self.length_m:.1f} m, {energy_words(self.energy_j)}>"
