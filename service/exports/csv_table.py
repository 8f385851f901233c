"""CSV: what is driven, metre by metre, in the coordinates of the map and, where they are known, in degrees."""

from __future__ import annotations

import csv
import io

import numpy as np
from numpy.typing import NDArray

from joulemap.service.exports.track import Line, Track, degree_text
from joulemap.service.places.coordinates import to_wgs84

COLUMNS = (
    "x_m",
    "y_m",
    "z_m",
    "latitude_deg",
    "longitude_deg",
    "leg",
    "distance_m",
    "heading_deg",
    "energy_j",
    "cumulative_j",
)


def write(track: Track) -> bytes:
    """Return what is driven as a CSV file.

    Result: UTF-8; a row for the start of every leg and for the end of each piece of a metre, corners among them.
    Unknown values are empty: heights, degrees of a map without CRS, energies of a drive that was not priced.
    """
    out = io.StringIO(newline="")
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    for number, line in enumerate(track.driven, start=1):
        rows = _rows(line)
        degrees = None if track.crs is None else to_wgs84(track.crs, rows[:, :2])
        for k, (x, y, z, *rest) in enumerate(rows.tolist()):
            lat, lon = ("", "") if degrees is None else (degree_text(degrees[k, 1]), degree_text(degrees[k, 0]))
            table.writerow([repr(x), repr(y), _text(z), lat, lon, number, *map(_text, rest)])
    return out.getvalue().encode()


def _rows(line: Line) -> NDArray[np.float64]:
    """(n, 7) x, y, z, distance, heading, energy, cumulative energy."""
    unknown = np.nan
    if line.profile is None:
        return np.column_stack([line.points, line.along_m, np.full((len(line.points), 3), unknown)])
    p = line.profile
    start = [*line.points[0], 0.0, unknown, 0.0, 0.0]
    heading = np.rad2deg(p.heading_rad)
    pieces = np.column_stack([p.x, p.y, p.z, p.distance_m, heading, p.energy_j, p.cumulative_j])
    return np.vstack([start, pieces])


def _text(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else ""
