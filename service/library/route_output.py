"""What routes and tours of the Python library write: files, tables, numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from joulemap.model.errors import InputError
from joulemap.planner.route import Route
from joulemap.service.exports.routes import route_file, route_format_of
from joulemap.service.exports.track import Track

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


def save_track(track: Track, path: str | Path, format: str | None, coordinates: str | None) -> Path:
    """Write a track for another program.

    `format`: a name of `joulemap.service.exports.routes.ROUTE_FORMATS`, None where the suffix decides.
    """
    file = Path(path)
    file.write_bytes(route_file(track, route_format_of(file, format), coordinates=coordinates))
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
