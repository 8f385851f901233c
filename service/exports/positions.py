"""Positions as files have them: longitude and latitude, rounded, so that what is read again may still be driven."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, world_points
from joulemap.service.exports.clearance import FURTHEST_M, cleared
from joulemap.service.exports.track import Line, Track
from joulemap.service.places.coordinates import DECIMALS, from_wgs84, to_wgs84


def degrees_of(track: Track, line: Line) -> NDArray[np.float64]:
    """Return the corners of a line as a file has them.

    Result (n, 2): longitude, latitude [degrees], rounded, within 1 cm of the corners. Read again, all legs may be
    driven that may be driven, unless a passage is as narrow as a line.
    """
    plain = to_wgs84(track.crs, line.points)
    if track.lattice is None:
        return np.round(plain, DECIMALS)
    lattice = track.lattice
    places = cleared(
        lattice,
        world_points(lattice, line.points),
        furthest_m=FURTHEST_M,
        quantise=lambda points: read_again(lattice, points),
    )
    x, y = lattice.frame.xy(places[:, 0], places[:, 1])
    return np.round(to_wgs84(track.crs, np.column_stack([x, y])), DECIMALS)


def read_again(lattice: CostLattice, points: Points) -> Points:
    """Return places of a lattice after they were written in degrees and read again.

    `points` (n, 2): fractional (row, col). The result is (n, 2).
    """
    frame = lattice.frame
    lonlat = np.round(to_wgs84(frame.crs, np.column_stack(frame.xy(points[:, 0], points[:, 1]))), DECIMALS)
    return world_points(lattice, from_wgs84(frame.crs, lonlat))


def degree_text(value: float) -> str:
    """Return degrees as text. `value`: longitude or latitude [degrees]."""
    return f"{value:.{DECIMALS}f}"
