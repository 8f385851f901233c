"""Published closed forms of what driving a metre costs, and the predictor that needs nothing else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_vector, wrap_angle
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.rows import columns_between, sample_row
from joulemap.model.threads import pieces, share_out

FloatArray = NDArray[np.float64]

SEGMENT_M = 1.0
"""Horizontal length of a segment [m]: the paper's d. Source: Wei & Isler 2022, section V-D."""

_ROWS_AT_ONCE = 32


def eq5_traction_per_m(weight_n: ArrayLike, rolling_resistance: ArrayLike, tan_grade: ArrayLike) -> FloatArray:
    """Traction demand per horizontal metre [J/m]: m g (mu + tan theta). Any shapes that broadcast.

    weight_n : m g [N]. rolling_resistance : mu, dimensionless. tan_grade : tan of the pitch along the motion, > 0
    uphill. Negative where the ground pushes the robot. Valid at constant speed on ground that wheels do not sink into
    or bounce over.
    Source: Wei & Isler 2022, eq. 5, E = m g (mu cos theta + sin theta) d with d = 1 / cos theta along the surface.
    """
    grade = np.asarray(tan_grade, dtype=np.float64)
    return np.asarray(weight_n, dtype=np.float64) * (np.asarray(rolling_resistance, dtype=np.float64) + grade)


def eq5_energy_j(
    weight_n: ArrayLike, rolling_resistance: ArrayLike, pitch_rad: ArrayLike, driven_m: ArrayLike
) -> FloatArray:
    """Energy of `driven_m` along the surface [J], as the paper prints it: (mu m g cos theta + m g sin theta) d.

    pitch_rad : theta, > 0 uphill. Negative where the ground pushes. Source: Wei & Isler 2022, eq. 5.
    """
    pitch = np.asarray(pitch_rad, dtype=np.float64)
    mu = np.asarray(rolling_resistance, dtype=np.float64)
    return np.asarray(weight_n, dtype=np.float64) * (mu * np.cos(pitch) + np.sin(pitch)) * np.asarray(driven_m)


def fit_rolling_resistance(traction_per_m: ArrayLike, tan_grade: ArrayLike, *, weight_n: float) -> float:
    """The one mu that fits measured segments best in the sense of least squares: the paper's global friction.

    traction_per_m, tan_grade : (n,) energy per horizontal metre without the hotel load [J/m], and the grade. With
    t = m g (mu + tan theta) the least squares solution is mean(t) / (m g) - mean(tan theta). NaN entries are left out.
    Raises InputError without a finite pair. Valid where nothing is clipped (no braking).
    Source: Wei & Isler 2022, section V-D ("a least-square method can be used to fit a value for mu").
    """
    traction = np.asarray(traction_per_m, dtype=np.float64).ravel()
    grade = np.asarray(tan_grade, dtype=np.float64).ravel()
    if traction.shape != grade.shape:
        raise InputError(f"{traction.size} measured segments need as many grades, got {grade.size}")
    if not (math.isfinite(weight_n) and weight_n > 0):
        raise InputError(f"weight_n must be a positive number of newtons, got {weight_n}", weight_n=str(weight_n))
    known = np.isfinite(traction) & np.isfinite(grade)
    if not known.any():
        raise InputError("rolling resistance cannot be fitted: there is no segment with a known energy and grade")
    return float(traction[known].mean() / weight_n - grade[known].mean())


def local_rolling_resistance(
    traction_per_m: ArrayLike, tan_grade: ArrayLike, *, weight_n: float, segments: int = 5
) -> FloatArray:
    """mu for every segment of one run, fitted to the block of `segments` before its own; NaN in the first block.

    Five metres of driving give mu for the next five, the paper's second baseline. Inputs (n,) in driving order, as
    `fit_rolling_resistance`. Source: Wei & Isler 2022, section V-D, Fig. 8 right.
    """
    traction = np.asarray(traction_per_m, dtype=np.float64).ravel()
    grade = np.asarray(tan_grade, dtype=np.float64).ravel()
    if segments < 1:
        raise InputError(f"a block needs at least one segment, got {segments}", segments=segments)
    out = np.full(traction.size, np.nan)
    for start in range(segments, traction.size, segments):
        before = slice(start - segments, start)
        if (np.isfinite(traction[before]) & np.isfinite(grade[before])).any():
            out[start : start + segments] = fit_rolling_resistance(traction[before], grade[before], weight_n=weight_n)
    return out


def tan_grade(heightmap: Heightmap, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike) -> FloatArray:
    """tan of the pitch of 1 m segments centred at (x, y) along a heading, > 0 uphill. Shapes broadcast; NaN unknown.

    Heights are sampled bilinearly half a metre behind and ahead, so that the answer is exact on planes.
    """
    dx, dy = heading_vector(heading_rad)
    half = 0.5 * SEGMENT_M
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    ahead = heightmap.sample(x + half * dx, y + half * dy)
    behind = heightmap.sample(x - half * dx, y - half * dy)
    return np.asarray((ahead - behind) / SEGMENT_M)


def tan_grade_lattice(heightmap: Heightmap, frame: GridFrame, headings_rad: FloatArray) -> NDArray[np.float32]:
    """`tan_grade` at the cell centres of `frame`. Returns (rows, cols, headings) float32, NaN where unknown."""
    headings = np.ascontiguousarray(headings_rad, dtype=np.float64)
    own, sign = antipodes(headings)
    x, y = frame.centres()
    row, _ = heightmap.frame.rowcol(0.0, y)
    _, col = heightmap.frame.rowcol(x, 0.0)
    dx, dy = heading_vector(headings)
    half_pixels = 0.5 * SEGMENT_M / heightmap.resolution_m
    out = np.empty((frame.rows, frame.cols, headings.size), dtype=np.float32)
    down, right = -dy * half_pixels, dx * half_pixels
    share_out(
        lambda rows: _grades(heightmap.heights, row[rows], col, down, right, own, sign, SEGMENT_M, out[rows]),
        pieces(frame.rows, _ROWS_AT_ONCE),
    )
    return out


def antipodes(headings: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """For each heading the earlier one that looks the opposite way (sign -1), else itself (+1)."""
    own = np.arange(headings.size)
    sign = np.ones(headings.size)
    for k in range(1, headings.size):
        opposite = np.flatnonzero(np.abs(wrap_angle(headings[:k] - headings[k] - math.pi)) < 1e-12)
        if opposite.size and sign[opposite[0]] > 0:
            own[k], sign[k] = opposite[0], -1.0
    return own, sign


@njit(cache=True, nogil=True)
def _grades(heights, row, col, drow, dcol, own, sign, length_m, out):
    ahead = [columns_between(col + right, heights.shape[1]) for right in dcol]
    behind = [columns_between(col - right, heights.shape[1]) for right in dcol]
    line, high, low = np.empty(heights.shape[1]), np.empty(col.size), np.empty(col.size)
    grades = np.empty((drow.size, col.size), dtype=np.float32)
    for i in range(row.size):
        for k in range(drow.size):
            if sign[k] < 0.0:
                grades[k] = -grades[own[k]]
            else:
                sample_row(heights, row[i] + drow[k], ahead[k], line, high)
                sample_row(heights, row[i] - drow[k], behind[k], line, low)
                grades[k] = (high - low) / length_m
        for j in range(col.size):
            for k in range(drow.size):
                out[i, j, k] = grades[k, j]


class PhysicsPredictor:
    """The paper's eq. 5 with the robot's declared rolling resistance: no weights, exact on planes, knows no bumps."""

    name = "physics"
    spread = Spread()

    def provenance(self) -> dict[str, Any]:
        """What the predictor is, JSON-able."""
        return {
            "name": self.name,
            "kind": "physics",
            "version": "1",
            "config": {"equation": "m g (mu + tan theta) per horizontal metre", "source": "Wei & Isler 2022, eq. 5"},
        }

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Where eq. 5 stops being what it says: cells longer than the segment hide the pitch it needs."""
        if heightmap.resolution_m > SEGMENT_M:
            return [
                f"the heightmap's cells are {heightmap.resolution_m:g} m, longer than the {SEGMENT_M:g} m segment "
                "whose pitch equation 5 needs: slopes within a cell are not seen"
            ]
        return []

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> NDArray[np.float32]:
        """m g (mu + tan theta) [J/m] at the cell centres of `frame`: (rows, cols, headings) float32, NaN unknown."""
        traction = tan_grade_lattice(heightmap, frame, headings_rad)
        traction += np.float32(robot.rolling_resistance)
        traction *= np.float32(robot.weight_n)
        return traction

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], None]:
        """`traction_per_m`, and no word of how far off it may be: eq. 5 has none."""
        return self.traction_per_m(heightmap, robot, frame, headings_rad), None

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """The same for 1 m segments centred at (x, y). (n,) float64 [J/m]."""
        grade = np.atleast_1d(tan_grade(heightmap, x, y, heading_rad))
        return eq5_traction_per_m(robot.weight_n, robot.rolling_resistance, grade)

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, None]:
        """`segment_traction`, and no word of how far off it may be."""
        return self.segment_traction(heightmap, robot, x, y, heading_rad), None
