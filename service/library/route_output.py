"""What routes and tours of the Python library write: files, tables, numbers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from joulemap.model.errors import InputError
from joulemap.planner.answers import Plan, RoundTrip
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.service.exports.formats import format_of
from joulemap.service.exports.geojson import geojson_document
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from joulemap.service.exports.track import Track

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


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
    """Return the numbers by which a route is told in words and tables.

    Result: `energy_j` [J], `length_m` [m] and `duration_s` [s].
    """
    return {"energy_j": route.energy_j, "length_m": route.length_m, "duration_s": route.duration_s}


def geodataframe(routes: Sequence[tuple[str, Route]], crs: str | None) -> GeoDataFrame:
    """Return routes as a table with a geometry."""
    try:
        from geopandas import GeoDataFrame
        from shapely import LineString
    except ImportError as error:
        raise InputError("a GeoDataFrame needs geopandas: pip install 'joulemap[geo]'") from error
    rows = [{"kind": kind, **route_numbers(route)} for kind, route in routes]
    lines = []
    for _, route in routes:  # a line has two points at least
        points = route.points if len(route.points) > 1 else np.repeat(route.points, 2, axis=0)
        lines.append(LineString(points))
    return GeoDataFrame(rows, geometry=lines, crs=crs)
