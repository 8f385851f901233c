"""The cost lattice: what driving costs at every cell and heading, what is blocked and why, and how it was made."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_bins, heading_vector
from joulemap.model.robot import Robot
from joulemap.planner.lattice.obstacles import MEETS, Closed, Obstacles, close_by_heading, closed_ground


class Blocked(IntEnum):
    """Why a cell, or a heading in a cell, cannot be driven. Lower codes win where several hold."""

    FREE = 0
    OUTSIDE = 1  # the square metre around the cell leaves the heightmap
    UNKNOWN = 2  # a height in it is unknown
    STEP = 3  # a height jump above the wheel radius
    GRADE = 4  # steeper along the motion than max_grade_deg (this heading only)
    CROSS_SLOPE = 5  # steeper across the motion than max_cross_slope_deg (this heading only)
    AVOID = 6  # a question asked to keep out, see `avoid`
    POWER = 7  # more power than a question allows (this heading only), see `CostLattice.max_traction_per_m`
    OBSTACLE = MEETS  # the robot's outline would meet a step, a wall or another obstacle

    @property
    def label(self) -> str:
        """The reason's name in files and answers, for example "cross_slope"."""
        return self.name.lower()


@dataclass(frozen=True, eq=False, repr=False)
class CostLattice:
    """A directional cost map for one robot on one heightmap.

    Attributes
    ----------
    frame : GridFrame
        Where the cells lie; cell (0, 0) is north-west.
    robot : Robot
        Whose prices and limits these are.
    traction_per_m : ndarray of float32, (rows, cols, headings)
        Energy that motion alone needs per horizontal metre on the 1 m segment centred at the cell [J/m]: negative where
        the ground pushes, NaN where unknown. Stored instead of the price because it is smooth in heading, so its
        periodic interpolation is exact where the price has a kink.
    elevation_m : ndarray of float32, (rows, cols)
        Elevation at cell centres [m].
    gradient : ndarray of float32, (rows, cols, 2)
        Rise per metre towards east and north of the plane through the square metre around the cell.
    blocked : ndarray of uint8, (rows, cols)
        A `Blocked` code that holds for every heading. Limits that depend on the heading follow from `gradient` and the
        robot, see `blocked_by_heading`.
    provenance : dict
        JSON-able record of model, heightmap hash, settings, versions and warnings.
    std_j : ndarray of float32, (rows, cols, headings), or None
        Standard deviation of the energy of the 1 m segment centred at the cell [J]; None where the model gives none.
    max_traction_per_m : float
        A heading in a cell that needs more is blocked [J/m]: a limit of power, over the speed. By default none is.
    obstacles : Obstacles, or None
        What the robot's outline must not meet on any leg; None where there is nothing of that kind.
    """

    frame: GridFrame
    robot: Robot
    traction_per_m: NDArray[np.float32]
    elevation_m: NDArray[np.float32]
    gradient: NDArray[np.float32]
    blocked: NDArray[np.uint8]
    provenance: dict[str, Any] = field(default_factory=dict)
    std_j: NDArray[np.float32] | None = None
    max_traction_per_m: float = math.inf
    obstacles: Obstacles | None = None

    def __post_init__(self) -> None:
        shapes = {
            "traction_per_m": (*self.frame.shape, self.traction_per_m.shape[-1]),
            "elevation_m": self.frame.shape,
            "gradient": (*self.frame.shape, 2),
            "blocked": self.frame.shape,
        }
        if self.std_j is not None:
            shapes["std_j"] = self.traction_per_m.shape
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"lattice: {name} has shape {getattr(self, name).shape}, expected {shape}")
        if self.headings < 4:
            raise InputError(f"lattice: at least 4 headings are needed, got {self.headings}", headings=self.headings)

    def __repr__(self) -> str:
        free = float((self.blocked == Blocked.FREE).mean())
        return (
            f"CostLattice({self.frame.rows} x {self.frame.cols} cells of {self.frame.resolution_m:g} m, "
            f"{self.headings} headings, for {self.robot.name}, {1.0 - free:.1%} of the cells blocked)"
        )

    def __str__(self) -> str:
        west, south, east, north = self.frame.bounds
        codes, counts = np.unique(self.blocked, return_counts=True)
        shares = ", ".join(
            f"{Blocked(code).label.replace('_', ' ')} {count / self.blocked.size:.1%}"
            for code, count in zip(codes.tolist(), counts.tolist(), strict=True)
        )
        lines = [
            f"cost lattice for {self.robot.name}: {self.frame.rows} x {self.frame.cols} cells of "
            f"{self.frame.resolution_m:g} m, {self.headings} headings",
            f"x {west:.2f}..{east:.2f} m, y {south:.2f}..{north:.2f} m, {self.frame.crs or 'no CRS'}",
            f"cells: {shares}; limits that depend on the heading come on top",
        ]
        model = self.provenance.get("model", {}).get("name")
        return "\n".join([*lines, f"model: {model}"] if model else lines)

    @property
    def headings(self) -> int:
        """Number of heading bins K; bin k points to 2 pi k / K, clockwise from north."""
        return int(self.traction_per_m.shape[2])

    @cached_property
    def energy_per_m(self) -> NDArray[np.float32]:
        """Price [J/m] of the 1 m segment centred at each cell: float32, (rows, cols, headings)."""
        return self.robot.price_per_m(self.traction_per_m).astype(np.float32)

    @cached_property
    def mean_per_m(self) -> tuple[float, float | None]:
        """Mean price [J/m], and mean standard deviation of a 1 m segment [J], where they are known."""
        std = None if self.std_j is None else float(np.nanmean(self.std_j))
        return float(np.nanmean(self.energy_per_m)), std

    @cached_property
    def max_tangents(self) -> tuple[float, float]:
        """The robot's limits as tangents: along the motion, and across it."""
        return float(np.tan(np.deg2rad(self.robot.max_grade_deg))), float(
            np.tan(np.deg2rad(self.robot.max_cross_slope_deg))
        )

    @cached_property
    def closed(self) -> Closed:
        """What closes legs beside slopes, for the pricing kernels."""
        return closed_ground(self.blocked, self.obstacles, self.frame, self.robot)

    def blocked_at(self, headings_rad: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return why cells may not be driven at some headings, limits on grade and cross slope included.

        Parameters
        ----------
        headings_rad : ndarray of float, (n,)
            Headings [rad, clockwise from north].

        Returns
        -------
        ndarray of uint8, (rows, cols, n)
            `Blocked` codes.
        """
        east, north = heading_vector(headings_rad)  # (n,)
        rise_east, rise_north = self.gradient[..., :1], self.gradient[..., 1:]
        max_grade, max_cross = self.max_tangents
        codes = np.zeros((*self.frame.shape, np.size(headings_rad)), dtype=np.uint8)
        codes[np.abs(rise_east * north - rise_north * east) > max_cross] = Blocked.CROSS_SLOPE
        codes[np.abs(rise_east * east + rise_north * north) > max_grade] = Blocked.GRADE
        codes = np.where(self.blocked[..., None] > 0, self.blocked[..., None], codes)
        if self.obstacles is not None:
            close_by_heading(self.closed, np.atleast_1d(east), np.atleast_1d(north), codes)
        return codes

    def window(self, row0: int, row1: int, col0: int = 0, col1: int | None = None) -> CostLattice:
        """Return the lattice of cells [row0, row1) x [col0, col1).

        Parameters
        ----------
        row0, row1 : int
            First row, and the one after the last.
        col0, col1 : int
            First column, and the one after the last; all columns by default.

        Returns
        -------
        CostLattice
            Its arrays are views, not copies.
        """
        part = np.s_[row0:row1, col0:col1]
        return replace(
            self,
            frame=self.frame.window(row0, row1, col0, col1),
            traction_per_m=self.traction_per_m[part],
            elevation_m=self.elevation_m[part],
            gradient=self.gradient[part],
            blocked=self.blocked[part],
            std_j=None if self.std_j is None else self.std_j[part],
            obstacles=None if self.obstacles is None else self.obstacles.window(row0, col0),
        )

    def blocked_by_heading(self) -> NDArray[np.uint8]:
        """Return the `Blocked` codes at every heading bin, limit of power included: uint8, (rows, cols, headings)."""
        codes = self.blocked_at(heading_bins(self.headings))
        if math.isfinite(self.max_traction_per_m):
            codes[(codes == Blocked.FREE) & (self.traction_per_m > self.max_traction_per_m)] = Blocked.POWER
        return codes

    def mean_energy_per_m(self) -> NDArray[np.float64]:
        """Return the mean price over the headings that may be driven: (rows, cols) [J/m]; NaN where there are none."""
        free = self.blocked_by_heading() == Blocked.FREE
        total, count = np.where(free, self.energy_per_m, 0.0).sum(axis=2, dtype=np.float64), free.sum(axis=2)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def blocked_shares(self) -> dict[str, float]:
        """Return the share of (cell, heading) pairs under each reason, `free` included; the values sum to 1."""
        counts = np.bincount(self.blocked_by_heading().ravel(), minlength=len(Blocked))
        return {reason.label: float(counts[reason] / counts.sum()) for reason in Blocked}
