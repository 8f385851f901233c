"""Fit a surface to the positions a robot drove over, as the paper makes its heightmap."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse
from scipy.sparse import linalg as sparse_linalg

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

_MIN_CELLS = 12
_PASSES = (4.0, 2.0, 1.0, 1.0, 1.0)  # coarse first, so that a burst of bad fixes cannot pull the surface to itself
_BIWEIGHT = 6.0  # in robust standard deviations
_NOISE_FLOOR_M = 0.003


def fit_surface(
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    *,
    resolution_m: float = 0.1,
    smoothing_m: float = 1.0,
    max_gap_m: float = 1.0,
    crs: str | None = None,
    max_cells: int = 100_000_000,
) -> Heightmap:
    """Fit a heightmap to driven RTK-GPS positions.

    `x`, `y` (n,): world positions [m], rows with a missing or infinite value are left out; `z` (n,): height of the
    antenna less its height above the ground [m]. Result: heights near the driven positions, NaN elsewhere.

    A smoothing thin-plate surface: cubic B-splines on knots of smoothing_m / 3, least squares plus the bending energy,
    solved sparsely on driven ground only.

    Points within one cell count once, at their mean place and median height, so that a robot that does not move adds
    no weight. Outliers: Tukey's biweight over five passes from coarse to fine. A cell whose height is off the surface
    by more than 6 robust standard deviations (1.4826 x median deviation, at least 3 mm) has no weight and does not
    count as driven. Wrong *positions* far from the rest are not recognised: drop rows with a large GPS error first.

    Reference: Wei & Isler 2022, section IV-B: "we fit a surface with the GPS positions along the trajectory".
    Eilers & Marx 1996, Flexible smoothing with B-splines and penalties.
    """
    for name, value in (("resolution_m", resolution_m), ("smoothing_m", smoothing_m), ("max_gap_m", max_gap_m)):
        if not (math.isfinite(value) and value > 0):
            raise HeightmapError(f"{name} must be a positive number of metres, got {value}", name=name)
    points = np.stack(np.broadcast_arrays(*(np.asarray(a, dtype=np.float64).ravel() for a in (x, y, z))))
    points = points[:, np.isfinite(points).all(axis=0)]  # (3, n)
    if points.shape[1] < _MIN_CELLS:
        raise HeightmapError(f"{points.shape[1]} usable points were given; a surface needs at least {_MIN_CELLS}")
    frame = _frame_around(points[0], points[1], resolution_m, max_gap_m, crs, max_cells)
    cells = _merge_by_cell(points, frame)
    if cells.z.size < _MIN_CELLS:
        raise HeightmapError(
            f"the points lie in {cells.z.size} cells of {resolution_m:g} m; a surface needs at least {_MIN_CELLS}"
        )
    reach = _near(cells, np.ones(cells.z.size, dtype=bool), frame, max_gap_m)
    spline = _Spline.over(reach, frame, knot_m=max(smoothing_m / 3.0, resolution_m))
    coefficients, weight = _robust_fit(cells, spline, smoothing_m, reach)
    heights = spline.on_grid(coefficients, frame)
    heights[~_near(cells, weight > 0.0, frame, max_gap_m)] = np.nan
    return Heightmap(heights.astype(np.float32), frame, source="driven points")


@dataclass(frozen=True)
class _Cells:
    """Points merged by cell: fractional place, height and cell, each (m,)."""

    row: FloatArray
    col: FloatArray
    z: FloatArray
    index: NDArray[np.int64]  # flat index into the frame


def _frame_around(
    x: FloatArray, y: FloatArray, resolution_m: float, margin_m: float, crs: str | None, max_cells: int
) -> GridFrame:
    west = math.floor((x.min() - margin_m) / resolution_m)
    east = math.ceil((x.max() + margin_m) / resolution_m)
    south = math.floor((y.min() - margin_m) / resolution_m)
    north = math.ceil((y.max() + margin_m) / resolution_m)
    rows, cols = north - south, east - west
    if rows * cols > max_cells:
        raise TooLargeError(
            f"the points spread over {np.ptp(x):.0f} x {np.ptp(y):.0f} m: {rows * cols} cells of {resolution_m:g} m, "
            f"more than the limit of {max_cells}; drop far-off positions or take a coarser resolution",
            cells=rows * cols,
            limit=max_cells,
        )
    # Rounded to the micrometre: 4999993 x 0.1 is not 499999.3 in binary.
    return GridFrame(round(west * resolution_m, 6), round(north * resolution_m, 6), resolution_m, rows, cols, crs)


def _merge_by_cell(points: FloatArray, frame: GridFrame) -> _Cells:
    row, col = frame.rowcol(points[0], points[1])
    i = np.clip(np.floor(row + 0.5).astype(np.int64), 0, frame.rows - 1)
    j = np.clip(np.floor(col + 0.5).astype(np.int64), 0, frame.cols - 1)
    index, inverse, count = np.unique(i * frame.cols + j, return_inverse=True, return_counts=True)
    order = np.lexsort((points[2], inverse))
    sorted_z = points[2][order]
    first = np.concatenate(([0], np.cumsum(count)[:-1]))
    median = 0.5 * (sorted_z[first + (count - 1) // 2] + sorted_z[first + count // 2])
    return _Cells(np.bincount(inverse, row) / count, np.bincount(inverse, col) / count, median, index)


def _near(cells: _Cells, kept: NDArray[np.bool_], frame: GridFrame, max_gap_m: float) -> NDArray[np.bool_]:
    """(rows, cols): cells within max_gap_m of a kept one, centre to centre."""
    away = np.ones(frame.shape, dtype=bool)
    away.ravel()[cells.index[kept]] = False
    return ndimage.distance_transform_edt(away) * frame.resolution_m <= max_gap_m


@dataclass(frozen=True)
class _Spline:
    """A tensor cubic B-spline over the frame; only coefficients that reach driven ground exist.

    number : (knot rows, knot cols) index of each coefficient, -1 where there is none. step : knot spacing in cells.
    """

    number: NDArray[np.int64]
    step: float
    knot_m: float

    @classmethod
    def over(cls, reach: NDArray[np.bool_], frame: GridFrame, *, knot_m: float) -> _Spline:
        step = knot_m / frame.resolution_m
        rows, cols = (int((n - 0.5) / step) + 5 for n in frame.shape)
        active = np.zeros((rows, cols), dtype=bool)
        i, j = np.nonzero(reach)
        # A driven cell's points lie anywhere within it, so both ends decide which splines it needs.
        for di in (0.0, 1.0):
            for dj in (0.0, 1.0):
                active[((i + di) / step).astype(np.int64), ((j + dj) / step).astype(np.int64)] = True
        starts = active.copy()
        for di in range(4):
            for dj in range(4):
                active[di:, dj:] |= starts[: rows - di, : cols - dj]
        number = np.full(active.shape, -1, dtype=np.int64)
        number[active] = np.arange(active.sum())
        return cls(number, step, knot_m)

    @property
    def size(self) -> int:
        return int(self.number.max()) + 1

    def at(self, row: FloatArray, col: FloatArray) -> sparse.csr_array:
        """(points, size): the splines' values at fractional cells."""
        first_row, by_row = _basis((row + 0.5) / self.step)
        first_col, by_col = _basis((col + 0.5) / self.step)
        four = np.arange(4)
        columns = self.number[(first_row[:, None] + four)[:, :, None], (first_col[:, None] + four)[:, None, :]]
        values = by_row[:, :, None] * by_col[:, None, :]  # (points, 4, 4)
        pointer = np.arange(0, 16 * row.size + 1, 16)
        return sparse.csr_array((values.ravel(), columns.ravel(), pointer), shape=(row.size, self.size))

    def bending(self) -> sparse.csr_array:
        """(size, size): the integral of h_xx^2 + 2 h_xy^2 + h_yy^2, by differences of the coefficients [1/m2]."""
        n = self.number
        along_rows = self._differences([n[:-2], n[1:-1], n[2:]], (1.0, -2.0, 1.0))
        along_cols = self._differences([n[:, :-2], n[:, 1:-1], n[:, 2:]], (1.0, -2.0, 1.0))
        mixed = self._differences([n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]], (1.0, -1.0, -1.0, 1.0))
        return (along_rows + along_cols + 2.0 * mixed) / self.knot_m**2

    def slope(self) -> sparse.csr_array:
        """(size, size): the integral of h_x^2 + h_y^2, likewise [1]."""
        n = self.number
        return self._differences([n[:-1], n[1:]], (-1.0, 1.0)) + self._differences([n[:, :-1], n[:, 1:]], (-1.0, 1.0))

    def _differences(self, numbers: list[NDArray[np.int64]], factors: tuple[float, ...]) -> sparse.csr_array:
        columns = np.stack([m.ravel() for m in numbers], axis=1)
        columns = columns[(columns >= 0).all(axis=1)]  # (differences, terms)
        values = np.broadcast_to(factors, columns.shape)
        pointer = np.arange(0, columns.size + 1, columns.shape[1])
        matrix = sparse.csr_array((values.ravel(), columns.ravel(), pointer), shape=(len(columns), self.size))
        return matrix.T @ matrix

    def on_grid(self, coefficients: FloatArray, frame: GridFrame) -> FloatArray:
        """(rows, cols) at cell centres; meaningless off driven ground."""
        knot_rows, knot_cols = self.number.shape
        full = np.zeros((knot_rows, knot_cols))
        full[self.number >= 0] = coefficients
        return self._along(frame.rows, knot_rows) @ (self._along(frame.cols, knot_cols) @ full.T).T

    def _along(self, cells: int, knots: int) -> sparse.csr_array:
        first, values = _basis((np.arange(cells) + 0.5) / self.step)
        pointer = np.arange(0, 4 * cells + 1, 4)
        return sparse.csr_array(
            (values.ravel(), (first[:, None] + np.arange(4)).ravel(), pointer), shape=(cells, knots)
        )


def _basis(u: NDArray[np.floating]) -> tuple[NDArray[np.int64], FloatArray]:
    """First of the four uniform cubic B-splines at u [knots], (n,), and their values, (n, 4)."""
    first = np.floor(u).astype(np.int64)
    t = u - first
    values = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1) / 6.0
    return first, values


def _robust_fit(
    cells: _Cells, spline: _Spline, smoothing_m: float, reach: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (size,) and the final weight (m,) of every merged cell."""
    design = spline.at(cells.row, cells.col)
    bending, slope = spline.bending(), spline.slope()
    # Heights are measured from a plane, which the surface approaches where the points alone do not decide.
    plane = np.stack([np.ones_like(cells.row), cells.row, cells.col], axis=1)
    trend = np.linalg.lstsq(plane, cells.z, rcond=None)[0]
    z = cells.z - plane @ trend
    cell_m = spline.knot_m / spline.step
    per_m2 = cells.z.size / (reach.sum() * cell_m**2)
    weight = np.ones(cells.z.size)
    coefficients = np.zeros(spline.size)
    for factor in _PASSES:
        # A wave k keeps rho / (rho + lambda k^4) of its height: half at k = 2 pi / length.
        length = smoothing_m * factor
        stiffness = per_m2 * (length / math.tau) ** 4
        levelling = stiffness * (math.tau / (50.0 * length)) ** 2
        normal = design.T @ (design * weight[:, None]) + stiffness * bending + levelling * slope
        normal = normal + 1e-9 * per_m2 * sparse.eye_array(spline.size)
        solver = sparse_linalg.splu(
            normal.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        coefficients = solver.solve(design.T @ (weight * z))
        residual = np.abs(z - design @ coefficients)
        scale = max(1.4826 * float(np.median(residual)), _NOISE_FLOOR_M)
        weight = np.clip(1.0 - (residual / (_BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
    knot_row, knot_col = np.nonzero(spline.number >= 0)
    # Cubic B-splines reproduce a plane from its values at their centres, which lie one knot before their index.
    row, col = ((k - 1) * spline.step - 0.5 for k in (knot_row, knot_col))
    return coefficients + trend[0] + trend[1] * row + trend[2] * col, weight
