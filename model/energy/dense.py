"""The compact network over a map: whole windows in dense passes, single segments by their squares, the same answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from model.energy.compact import PIXEL_M, SQUARE, STRIDE, CompactNet, heading_basis, robot_features
from model.energy.domain import Domain, Learned
from model.energy.physics import tan_grade, tan_grade_lattice
from model.frames import GridFrame
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from model.terrain.patches import cut_squares

FloatArray = NDArray[np.float64]

REACH_M = (SQUARE - 1) // 2 * PIXEL_M
"""How far around a place the network looks [m], along both axes."""

_TILE_ROWS, _TILE_COLS = 24, 64  # cells of one pass: its layers stay near the cache
_BATCH = 2048  # squares of one pass
_PASSES = 8  # a spacing of 1/k m up to this k is answered by k x k dense passes


class CompactPredictor(Learned):
    """Traction demand from a trained compact network.

    A cell is NaN where the 2 m square around it touches an unknown height. At the edge of the map the ground is
    continued by odd reflection (a plane stays a plane), so that edge cells have an answer.
    """

    def __init__(self, net: CompactNet, domain: Domain, provenance: Mapping[str, Any], *, name: str) -> None:
        super().__init__(name, domain, provenance)
        self.net = net.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> NDArray[np.float32]:
        """(rows, cols, headings) float32 [J/m] at the cell centres of `frame`; NaN where the map is unknown.

        Spacings of 1, 1/2, 1/3 ... 1/8 m are answered by dense passes, any other by one square per cell.
        """
        traction = tan_grade_lattice(heightmap, frame, headings_rad)  # (rows, cols, K), turned into traction below
        basis = heading_basis(headings_rad, self.net.config.order)
        film, gains = self._robot(heightmap, robot)
        x, y = frame.centres()
        parts = round(1.0 / frame.resolution_m)
        dense = 1 <= parts <= _PASSES and abs(parts * frame.resolution_m - 1.0) < 1e-9
        step = parts if dense else 1
        rolling, climb = float(gains[0]) * robot.rolling_resistance, float(gains[1])

        def fill(tile: tuple[slice, slice]) -> None:
            rows, cols = tile
            if dense:
                series = self._dense_series(heightmap, film, x[cols], y[rows])
            else:
                series = self._series_of_squares(heightmap, film, *np.meshgrid(x[cols], y[rows]))
            _assemble(traction[rows, cols], series, basis, rolling, climb, robot.weight_n)

        high, wide = _TILE_ROWS * step, _TILE_COLS * step
        tiles = [
            (slice(r, min(r + high, frame.rows), step), slice(c, min(c + wide, frame.cols), step))
            for i in range(step)
            for j in range(step)
            for r in range(i, frame.rows, high)
            for c in range(j, frame.cols, wide)
        ]
        if dense:
            _each(fill, tiles)
        else:  # cutting squares already takes every core
            for tile in tiles:
                fill(tile)
        return traction

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """The same for 1 m segments centred at (x, y). (n,) float64 [J/m]."""
        x, y, heading = (
            np.ascontiguousarray(a, dtype=np.float64).ravel() for a in np.broadcast_arrays(x, y, heading_rad)
        )
        film, gains = self._robot(heightmap, robot)
        series = self._series_of_squares(heightmap, film, x, y)
        learned = np.einsum("nc,nc->n", series, heading_basis(heading, self.net.config.order), dtype=np.float64)
        known = float(gains[0]) * robot.rolling_resistance + float(gains[1]) * tan_grade(heightmap, x, y, heading)
        return np.asarray(robot.weight_n * (known + learned))

    @torch.inference_mode()
    def _robot(self, heightmap: Heightmap, robot: Robot) -> tuple[torch.Tensor, NDArray[np.float32]]:
        film, gains = self.net.read_robot(torch.from_numpy(robot_features(robot, heightmap.resolution_m))[None])
        return film, gains[0].numpy()

    @torch.inference_mode()
    def _dense_series(
        self, heightmap: Heightmap, film: torch.Tensor, x: FloatArray, y: FloatArray
    ) -> NDArray[np.float32]:
        """Coefficients at cells whose centres are 1 m apart: (len(y), len(x), 2 order + 1)."""
        slopes = slope_raster(heightmap, x, y)  # (8 rows + 8, 8 cols + 8, 3)
        series = self.net.read_ground(torch.from_numpy(slopes).permute(2, 0, 1)[None], film)
        return np.ascontiguousarray(series[0].permute(1, 2, 0).numpy())

    @torch.inference_mode()
    def _series_of_squares(
        self, heightmap: Heightmap, film: torch.Tensor, x: FloatArray, y: FloatArray
    ) -> NDArray[np.float32]:
        """Coefficients at any points: (*x.shape, 2 order + 1)."""
        shape, xs, ys = x.shape, x.ravel(), y.ravel()
        out = np.empty((xs.size, 2 * self.net.config.order + 1), dtype=np.float32)
        for k in range(0, xs.size, _BATCH):
            part = slice(k, k + _BATCH)
            squares = cut_squares(heightmap, xs[part], ys[part], size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M)
            slopes = torch.from_numpy(_slopes_of(squares)).permute(0, 3, 1, 2)
            out[part] = self.net.read_ground(slopes, film)[:, :, 0, 0].numpy()
        return out.reshape(*shape, out.shape[1])


def _each(fill: Callable[[tuple[slice, slice]], None], tiles: Sequence[tuple[slice, slice]]) -> None:
    """A tile per thread, nothing shared inside a tile: threads that meet at a barrier after every layer stand still
    for most of the time when the machine has other work, here about eight times as long."""
    threads = torch.get_num_threads()
    try:
        with ThreadPoolExecutor(min(threads, len(tiles)), initializer=torch.set_num_threads, initargs=(1,)) as pool:
            for _ in pool.map(fill, tiles):
                pass
    finally:
        torch.set_num_threads(threads)


def slope_raster(heightmap: Heightmap, x: FloatArray, y: FloatArray) -> NDArray[np.float32]:
    """Rise to the east, to the north and twist on the working pixels of cells 1 m apart.

    x (cols,) ascending and y (rows,) descending : centres [m]. Returns (8 rows + 8, 8 cols + 8, 3) float32.
    """
    reach = (SQUARE - 1) // 2
    row = heightmap.frame.rowcol(0.0, y[0] - (np.arange(STRIDE * (y.size - 1) + SQUARE) - reach) * PIXEL_M)[0]
    col = heightmap.frame.rowcol(x[0] + (np.arange(STRIDE * (x.size - 1) + SQUARE) - reach) * PIXEL_M, 0.0)[1]
    (rows, row, pad_rows), (cols, col, pad_cols) = (
        _cover(at, n) for at, n in zip((row, col), heightmap.heights.shape, strict=True)
    )
    heights = heightmap.heights[rows, cols]
    if any((*pad_rows, *pad_cols)):
        heights = np.pad(heights, (pad_rows, pad_cols), mode="reflect", reflect_type="odd")
    return _slope_raster(np.ascontiguousarray(heights), row, col)


def _cover(at: FloatArray, size: int) -> tuple[slice, FloatArray, tuple[int, int]]:
    """The cells that samples at fractional indices need: (slice of the map, indices inside it, cells to pad)."""
    low, high = math.floor(at[0]) - 1, math.ceil(at[-1]) + 2
    before, after = max(-low, 0), max(high - size, 0)
    start, stop = max(low, 0), min(high, size)
    if before:
        stop = max(stop, min(before + 2, size))  # the mirror image of what is padded
    if after:
        start = min(start, max(size - after - 2, 0))
    return slice(start, stop), at - start + before, (before, after)


@njit(cache=True, inline="always")
def _between(at, size):  # fmt: skip
    """Lower and upper index and the share of the upper; a share of (nearly) nothing asks only one of them."""
    low = min(max(math.floor(at), 0), size - 1)
    share = at - low
    if share < 1e-9:
        return low, low, 0.0
    if share > 1.0 - 1e-9:
        return low + 1, low + 1, 0.0
    return low, low + 1, share


@njit(cache=True, nogil=True)
def _slope_raster(heights, row, col):  # fmt: skip
    out = np.empty((row.size - 1, col.size - 1, 3), dtype=np.float32)
    scale = 0.5 / PIXEL_M
    left = np.empty(col.size, dtype=np.int64)
    right = np.empty(col.size, dtype=np.int64)
    share = np.empty(col.size)
    for j in range(col.size):
        left[j], right[j], share[j] = _between(col[j], heights.shape[1])
    line = np.empty((2, col.size))
    for i in range(row.size):
        up, down, low = _between(row[i], heights.shape[0])
        for j in range(col.size):
            upper = heights[up, left[j]] + share[j] * (float(heights[up, right[j]]) - heights[up, left[j]])
            lower = heights[down, left[j]] + share[j] * (float(heights[down, right[j]]) - heights[down, left[j]])
            line[i % 2, j] = upper + low * (lower - upper)
        if i == 0:
            continue
        for j in range(col.size - 1):
            nw, ne = line[(i - 1) % 2, j], line[(i - 1) % 2, j + 1]
            sw, se = line[i % 2, j], line[i % 2, j + 1]
            out[i - 1, j, 0] = ((ne - nw) + (se - sw)) * scale
            out[i - 1, j, 1] = ((nw - sw) + (ne - se)) * scale
            out[i - 1, j, 2] = ((ne - nw) - (se - sw)) * scale
    return out


@njit(cache=True, parallel=True)
def _slopes_of(squares):  # fmt: skip
    n, size, _ = squares.shape
    out = np.empty((n, size - 1, size - 1, 3), dtype=np.float32)
    scale = 0.5 / PIXEL_M
    for k in prange(n):
        for i in range(size - 1):
            for j in range(size - 1):
                nw, ne = float(squares[k, i, j]), float(squares[k, i, j + 1])
                sw, se = float(squares[k, i + 1, j]), float(squares[k, i + 1, j + 1])
                out[k, i, j, 0] = ((ne - nw) + (se - sw)) * scale
                out[k, i, j, 1] = ((nw - sw) + (ne - se)) * scale
                out[k, i, j, 2] = ((ne - nw) - (se - sw)) * scale
    return out


@njit(cache=True, nogil=True)
def _assemble(grade_to_traction, series, basis, rolling, climb_gain, weight_n):  # fmt: skip
    """In place: grade (rows, cols, K) -> traction [J/m], from coefficients (rows, cols, C) and basis (K, C)."""
    rows, cols, count = grade_to_traction.shape
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                total = np.float32(0.0)
                for c in range(basis.shape[1]):
                    total += series[i, j, c] * basis[k, c]
                grade_to_traction[i, j, k] = weight_n * (rolling + climb_gain * grade_to_traction[i, j, k] + total)
