"""World and cell coordinates, headings and angle wrap: the only home of these conventions.

World: x east, y north, metres, in the map's CRS. Raster: row 0 is north; fractional (row, col) is (0, 0) at the
*centre* of the north-west cell. Heading: clockwise from north, radians inside, so a step of heading h moves
(sin h, cos h) in (x, y), and bin k of K is 2 pi k / K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import HeightmapError, PointError
from joulemap.model.ranges import COORDINATE_M, RESOLUTION_M

TAU = 2.0 * math.pi
RIM_CELLS = 1e-6
"""Places so far beyond the rim of a map [cells] are on it, as for legs (`planner.pricing.kernels`): coordinates are
rounded."""


def heading_bins(count: int) -> NDArray[np.float64]:
    """Return the headings of equal bins, bin 0 to the north.

    Parameters
    ----------
    count : int
        Number of bins.

    Returns
    -------
    ndarray of float64, (count,)
        Headings [rad].
    """
    return np.arange(count, dtype=np.float64) * (TAU / count)


def heading_vector(heading_rad: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the unit step of a heading.

    Parameters
    ----------
    heading_rad : array_like
        Heading [rad], of any shape.

    Returns
    -------
    tuple of ndarray
        dx (east) and dy (north), in the shape of the heading.
    """
    heading = np.asarray(heading_rad, dtype=np.float64)
    return np.sin(heading), np.cos(heading)


def heading_of(dx: ArrayLike, dy: ArrayLike) -> NDArray[np.float64]:
    """Return the heading of a step in the world.

    Parameters
    ----------
    dx, dy : array_like
        Step to the east and to the north, of any shape.

    Returns
    -------
    ndarray of float64
        Heading [rad], from 0 to less than 2 pi.
    """
    return np.mod(np.arctan2(dx, dy), TAU)


def wrap_angle(angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the same angle between -pi and pi.

    Parameters
    ----------
    angle_rad : array_like
        Angle [rad], of any shape.

    Returns
    -------
    ndarray of float64
        Angle [rad], from -pi to less than pi.
    """
    return np.mod(np.asarray(angle_rad, dtype=np.float64) + math.pi, TAU) - math.pi


@dataclass(frozen=True)
class GridFrame:
    """Where a north-up square grid lies in the world.

    Attributes
    ----------
    west_m, north_m : float
        Outer edges of the north-west cell [m].
    resolution_m : float
        Side of a cell [m].
    rows, cols : int
        Number of cells.
    crs : str or None
        "EPSG:n" or WKT, None when unknown.

    Raises
    ------
    HeightmapError
        If a number is not finite, or outside what a map may have.
    """

    west_m: float
    north_m: float
    resolution_m: float
    rows: int
    cols: int
    crs: str | None = None

    def __repr__(self) -> str:
        west, south, east, north = self.bounds
        return (
            f"GridFrame of {self.rows} x {self.cols} cells of {self.resolution_m:g} m: x {west:.10g} to {east:.10g} m, "
            f"y {south:.10g} to {north:.10g} m, {self.crs_in_words}"
        )

    def __post_init__(self) -> None:
        low, high = RESOLUTION_M.low, RESOLUTION_M.high
        if math.isfinite(self.resolution_m) and self.resolution_m > 0 and not low <= self.resolution_m <= high:
            raise HeightmapError(
                f"a resolution of {self.resolution_m:g} m is outside the {low:g}..{high:g} m a map may have",
                resolution_m=self.resolution_m,
                limit=[low, high],
            )
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise HeightmapError(
                f"resolution must be a positive number of metres, got {self.resolution_m}",
                resolution_m=self.resolution_m,
            )
        if not (math.isfinite(self.west_m) and math.isfinite(self.north_m)):
            raise HeightmapError(f"the map's corner must be finite, got ({self.west_m}, {self.north_m})")
        if self.west_m not in COORDINATE_M or self.north_m not in COORDINATE_M:
            raise HeightmapError(
                f"the map's corner ({self.west_m:g}, {self.north_m:g}) is beyond {COORDINATE_M.high:g} m",
                limit=COORDINATE_M.high,
            )
        if self.rows < 1 or self.cols < 1:
            raise HeightmapError(f"a map needs at least one cell, got {self.rows} x {self.cols}")
        for key in ("west_m", "north_m", "resolution_m"):
            # One place has one spelling, because Heightmap.data_hash depends on it: no 0 beside 0.0 and -0.0.
            object.__setattr__(self, key, float(getattr(self, key)) + 0.0)

    @property
    def crs_in_words(self) -> str:
        """The CRS as people name it: its code, the name in its WKT, or that it is unknown."""
        if self.crs is None:
            return "CRS unknown"
        return self.crs if '"' not in self.crs else self.crs.split('"')[1]

    @property
    def identity(self) -> str:
        """The frame as one exact text, of which `Heightmap.data_hash` is made; it never changes its form."""
        values = (f"{field.name}={getattr(self, field.name)!r}" for field in fields(self))
        return f"GridFrame({', '.join(values)})"

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.rows, self.cols

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) [m]: outer edges of the outer cells."""
        east = self.west_m + self.cols * self.resolution_m
        south = self.north_m - self.rows * self.resolution_m
        return self.west_m, south, east, self.north_m

    def rowcol(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the fractional cells of world points.

        Parameters
        ----------
        x, y : array_like
            World points [m], of any shape.

        Returns
        -------
        tuple of ndarray
            Row and column; (0, 0) is the centre of the north-west cell.
        """
        col = (np.asarray(x, dtype=np.float64) - self.west_m) / self.resolution_m - 0.5
        row = (self.north_m - np.asarray(y, dtype=np.float64)) / self.resolution_m - 0.5
        return row, col

    def xy(self, row: ArrayLike, col: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the world points of fractional cells.

        Parameters
        ----------
        row, col : array_like
            Row and column, of any shape; (0, 0) is the centre of the north-west cell.

        Returns
        -------
        tuple of ndarray
            World x and y [m].
        """
        x = self.west_m + (np.asarray(col, dtype=np.float64) + 0.5) * self.resolution_m
        y = self.north_m - (np.asarray(row, dtype=np.float64) + 0.5) * self.resolution_m
        return x, y

    def cell_of(self, x: float, y: float, *, name: str = "point") -> tuple[int, int]:
        """Return the cell that holds a world point.

        Parameters
        ----------
        x, y : float
            World point [m].
        name : str, optional
            What the message calls the point.

        Returns
        -------
        tuple of int
            Row and column.

        Raises
        ------
        PointError
            If the point is not finite, or lies outside the map.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise PointError(f"{name} ({x}, {y}) is not a pair of finite numbers", x=str(x), y=str(y))
        west, south, east, north = self.bounds
        slack = RIM_CELLS * self.resolution_m
        if not (west - slack <= x <= east + slack and south - slack <= y <= north + slack):
            raise PointError(
                f"{name} ({x:.2f}, {y:.2f}) lies outside the map, which spans x {west:.2f}..{east:.2f}, "
                f"y {south:.2f}..{north:.2f}{self._likely_mistake(x, y)}",
                x=x,
                y=y,
                bounds=[west, south, east, north],
            )
        row, col = self.rowcol(x, y)
        return min(int(row + 0.5), self.rows - 1), min(int(col + 0.5), self.cols - 1)

    def _likely_mistake(self, x: float, y: float) -> str:
        """What a sender of a point outside the map may have mixed up, to follow the message."""
        west, south, east, north = self.bounds
        if west <= y <= east and south <= x <= north:
            return "; with x and y exchanged it would lie inside"
        degrees = max(abs(x), abs(y)) <= 180.0 and min(abs(x), abs(y)) <= 90.0
        # on a map near the origin, small numbers are metres
        far = west > 180.0 or east < -180.0 or south > 180.0 or north < -180.0
        if self.crs is not None and degrees and far:
            return f"; this looks like latitude and longitude in degrees; the map is in metres of {self.crs_in_words}"
        return ""

    def centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the world x [m] of every column (cols,) and y [m] of every row (rows,), at cell centres."""
        x, _ = self.xy(0.0, np.arange(self.cols))
        _, y = self.xy(np.arange(self.rows), 0.0)
        return x, y

    def window(self, row0: int, row1: int, col0: int = 0, col1: int | None = None) -> GridFrame:
        """Return the frame of cells [row0, row1) x [col0, col1).

        Parameters
        ----------
        row0, row1 : int
            Rows of the window.
        col0, col1 : int, optional
            Its columns; all of them by default.

        Returns
        -------
        GridFrame
            Where these cells lie.
        """
        col1 = self.cols if col1 is None else col1
        return replace(
            self,
            west_m=self.west_m + col0 * self.resolution_m,
            north_m=self.north_m - row0 * self.resolution_m,
            rows=row1 - row0,
            cols=col1 - col0,
        )

    def respaced(self, spacing_m: float) -> GridFrame:
        """Return the grid of other cells that starts at the same north-west corner and fits inside.

        Parameters
        ----------
        spacing_m : float
            Side of a new cell [m].

        Returns
        -------
        GridFrame
            The new grid.

        Raises
        ------
        HeightmapError
            If fewer than 2 x 2 such cells fit inside.
        """
        if not (math.isfinite(spacing_m) and spacing_m > 0):
            raise HeightmapError(
                f"spacing must be a positive number of metres, got {spacing_m}", spacing_m=str(spacing_m)
            )
        rows = int(self.rows * self.resolution_m / spacing_m + 1e-6)
        cols = int(self.cols * self.resolution_m / spacing_m + 1e-6)
        if rows < 2 or cols < 2:
            raise HeightmapError(
                f"a map of {self.cols * self.resolution_m:g} x {self.rows * self.resolution_m:g} m is too small for "
                f"cells of {spacing_m:g} m: at least 2 x 2 are needed",
                spacing_m=spacing_m,
            )
        return replace(self, resolution_m=spacing_m, rows=rows, cols=cols)
