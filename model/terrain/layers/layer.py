"""One layer as a value: what it says at a place."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.ranges import HEIGHT_M
from joulemap.model.terrain.layers.kinds import MOST_FACTOR, Kind

KINDS, OBSTACLES, FREE, FACTOR, COST, HEIGHT = "kinds", "obstacles", "free", "factor", "cost", "height"
ROLES = {
    KINDS: "kinds of ground",
    OBSTACLES: "what no part of the robot may be over; unknown is free",
    FREE: "the only ground that the robot may be over; unknown and what lies outside is an obstacle",
    FACTOR: "a factor by which the energy of motion is multiplied",
    COST: "energy that is added [J/m]",
    HEIGHT: "heights in place of the map's, as of bridges and ramps [m]",
}
"""What a layer may be of."""

LIMITS = {FACTOR: (0.0, MOST_FACTOR), COST: (0.0, 1e6), HEIGHT: (HEIGHT_M.low, HEIGHT_M.high)}
"""Of the numbers of a layer. With a factor or cost below 0 driving would give energy; 1 MJ/m lifts a tonne by a hundred
metres."""

CostFunction = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], ArrayLike]
"""Of x, y [m] and heading [rad] of n places: what is added there [J/m], (n,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Layer:
    """One layer, on a north-up grid in the CRS of its heightmap.

    Attributes
    ----------
    role : str
        One of `ROLES`.
    source : str
        Where it is from, in words.
    frame : GridFrame, optional
        Of `values`; None of a function.
    values : ndarray, (rows, cols), optional
        Of kinds: numbers in `kinds`, -1 where unknown. Of obstacles and free ground: whether a cell is an obstacle. Of
        the others: the number, NaN where it is not known.
    kinds : tuple of Kind
        Of a layer of kinds.
    function : callable, optional
        Of a layer of costs, in place of values.
    remark : str
        What a user should know of it; empty where there is nothing to say.
    """

    role: str
    source: str
    frame: GridFrame | None = None
    values: NDArray[Any] | None = None
    kinds: tuple[Kind, ...] = ()
    function: CostFunction | None = None
    remark: str = ""

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise InputError(f"there is no layer of {self.role!r}: known are {', '.join(ROLES)}", role=self.role)
        if self.role in LIMITS and self.values is not None:
            check_numbers(self.role, self.values, self.source)
            object.__setattr__(self, "values", self.values.astype(np.float32))

    def at(self, x: ArrayLike, y: ArrayLike) -> NDArray[Any]:
        """Return the values of the cells that hold world points [m]; outside the layer it knows nothing.

        Parameters
        ----------
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray
            Of the layer's own numbers.
        """
        assert self.frame is not None
        assert self.values is not None
        row, col = (np.floor(at + 0.5).astype(np.int64) for at in self.frame.rowcol(x, y))
        inside = (row >= 0) & (row < self.frame.rows) & (col >= 0) & (col < self.frame.cols)
        found = self.values[np.clip(row, 0, self.frame.rows - 1), np.clip(col, 0, self.frame.cols - 1)]
        unknown = {KINDS: -1, OBSTACLES: False, FREE: True}.get(self.role, math.nan)
        return np.where(inside, found, np.asarray(unknown, dtype=found.dtype))

    def knows(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Return where it says something.

        Parameters
        ----------
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray of bool
            In the shape of the points. What is unknown in a layer of obstacles or of free ground has a meaning there.
        """
        assert self.frame is not None
        if self.role in (OBSTACLES, FREE):
            west, south, east, north = self.frame.bounds
            x, y = np.asarray(x), np.asarray(y)
            return np.asarray((x >= west) & (x <= east) & (y >= south) & (y <= north))
        found = self.at(x, y)
        return np.asarray(found >= 0 if self.role == KINDS else ~np.isnan(found))

    def over(self, heights: NDArray[np.float32], frame: GridFrame) -> NDArray[np.float32]:
        """Return the heights of a map with those of this layer where it has any.

        Parameters
        ----------
        heights : ndarray of float32, (rows, cols)
            Of the map [m].
        frame : GridFrame
            Its cells.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Bilinear between cells of the layer that are known; beside unknown ones that of the nearest cell.
        """
        assert self.frame is not None
        assert self.values is not None
        west, south, east, north = self._known_bounds
        x, y = frame.centres()
        rows, cols = np.flatnonzero((y >= south) & (y <= north)), np.flatnonzero((x >= west) & (x <= east))
        x, y, there = x[cols], y[rows], np.ix_(rows, cols)
        row, col = np.meshgrid(self.frame.rowcol(0.0, y)[0], self.frame.rowcol(x, 0.0)[1], indexing="ij")
        nearest, smooth = self.at(x, y[:, None]), map_coordinates(self.values, [row, col], order=1, mode="nearest")
        heights = heights.copy()
        own = np.where(np.isnan(smooth), nearest, smooth)
        heights[there] = np.where(np.isnan(nearest), heights[there], own)
        return heights

    @cached_property
    def _known_bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north [m] of the cells whose number is known."""
        assert self.frame is not None
        assert self.values is not None
        known = ~np.isnan(self.values)
        rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if not rows.size:
            return math.inf, math.inf, -math.inf, -math.inf
        return self.frame.window(rows[0], rows[-1] + 1, cols[0], cols[-1] + 1).bounds

    @property
    def closes(self) -> bool:
        """Whether it may have obstacles."""
        return self.role in (OBSTACLES, FREE) or any(kind.blocked for kind in self.kinds)

    def is_closed(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Return where it has obstacles.

        Parameters
        ----------
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray of bool
            In the shape of the points.
        """
        found = self.at(x, y)
        if self.role != KINDS:
            return np.asarray(found, dtype=np.bool_)
        return np.asarray(np.array([*(kind.blocked for kind in self.kinds), False])[found])

    @cached_property
    def data_hash(self) -> str | None:
        """SHA-256 (16 hex digits) of values and frame; None of a function."""
        if self.values is None or self.frame is None:
            return None
        digest = hashlib.sha256(np.ascontiguousarray(self.values).data)
        digest.update(self.frame.identity.encode())
        return digest.hexdigest()[:16]

    def as_dict(self) -> dict[str, Any]:
        """Return what it is, JSON-able."""
        out: dict[str, Any] = {"role": self.role, "source": self.source, "hash": self.data_hash}
        if self.frame is not None:
            out["resolution_m"] = self.frame.resolution_m
        return out | ({"kinds": [kind.as_dict() for kind in self.kinds]} if self.kinds else {})


def check_numbers(role: str, values: NDArray[Any], source: str) -> None:
    """Refuse numbers beyond the limits of their role; NaN is unknown.

    Raises InputError with the first number that is beyond, and the limits.
    """
    low, high = LIMITS[role]
    beyond = values[(values < low) | (values > high)]
    if beyond.size:
        unit = {COST: " J/m", HEIGHT: " m"}.get(role, "")
        raise InputError(
            f"a {role} in {source} is {float(beyond[0]):g}{unit}, and the limits are {low:g} and {high:g}{unit}",
            value=str(float(beyond[0])),
            limit=[low, high],
        )


def check_legend(given: object, roles: Iterable[str]) -> None:
    """Refuse a legend without a layer that it is of. Raises InputError if none of them is of kinds of ground."""
    if given and KINDS not in roles:
        raise InputError("there is a legend, and no layer of kinds of ground that it is of: give one, or no legend")
