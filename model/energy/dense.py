"""The compact network over a map: whole windows in dense passes, single segments by their squares, the same answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import ArrayLike, NDArray

from model.energy.compact import STRIDE, CompactNet, RobotCode, heading_basis, robot_features, slopes_of_squares
from model.energy.domain import Domain, Learned
from model.energy.head import Headings, answer_tile
from model.energy.physics import tan_grade, tan_grade_lattice
from model.energy.tracks import PIXEL_M, REACH_M, SQUARE, track_features
from model.energy.uncertainty import Spread, segment_std
from model.frames import GridFrame
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from model.terrain.patches import cut_squares

FloatArray = NDArray[np.float64]

_TILE_ROWS, _TILE_COLS = 24, 64  # cells of one pass: its layers stay near the cache
_BATCH = 2048  # squares of one pass
_PASSES = 8  # a spacing of 1/k m up to this k is answered by k x k dense passes


class CompactPredictor(Learned):
    """Traction demand, and how far off it may be, from a trained compact network.

    A cell is NaN where the 2 m square around it touches an unknown height. At the edge of the map the ground is
    continued by odd reflection (a plane stays a plane), so that edge cells have an answer.
    """

    def __init__(
        self, net: CompactNet, domain: Domain, provenance: Mapping[str, Any], *, name: str,
        spread: Spread | None = None, turn_j_per_rad: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(name, domain, provenance, spread=spread, turn_j_per_rad=turn_j_per_rad)
        self.net = net.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(traction [J/m], standard deviation of a 1 m segment's energy [J]), (rows, cols, headings) float32 each, at
        the cell centres of `frame`; NaN where the map is unknown.

        Spacings of 1, 1/2, 1/3 ... 1/8 m are answered by dense passes, any other by a square per cell and heading.
        """
        headings_rad = np.ascontiguousarray(headings_rad, dtype=np.float64)
        traction = tan_grade_lattice(heightmap, frame, headings_rad)  # (rows, cols, K), turned into traction below
        std = np.empty_like(traction)
        code = self._robot(heightmap, robot)
        headings = Headings.of(headings_rad, heading_basis(headings_rad, self.net.config.order), robot.width_m)
        weights, known = self.net.folded_head(code), self._known(code, robot)
        price = np.array([robot.hotel_per_m, robot.regeneration, self._level_j(robot), self.spread.factor])
        x, y = frame.centres()
        parts = round(1.0 / frame.resolution_m)
        dense = 1 <= parts <= _PASSES and abs(parts * frame.resolution_m - 1.0) < 1e-9
        step = parts if dense else 1

        def fill(tile: tuple[slice, slice]) -> None:
            rows, cols = tile
            heights = height_raster(heightmap, x[cols], y[rows])
            series = self._series(slopes_of(heights), code)
            answer_tile(
                heights, series, headings.basis, headings.stencil, headings.own, headings.sign, headings.per_width,
                weights, known, price, (rows.start, cols.start, step), traction, std,
            )  # fmt: skip

        if dense:
            high, wide = _TILE_ROWS * step, _TILE_COLS * step
            _each(
                fill,
                [
                    (slice(r, min(r + high, frame.rows), step), slice(c, min(c + wide, frame.cols), step))
                    for i in range(step)
                    for j in range(step)
                    for r in range(i, frame.rows, high)
                    for c in range(j, frame.cols, wide)
                ],
            )
        else:
            for row in range(frame.rows):
                places = np.broadcast_arrays(x[:, None], y[row], headings_rad)
                answer = self.segment_traction_and_std(heightmap, robot, *places)
                traction[row], std[row] = (a.reshape(traction.shape[1:]) for a in answer)
        return traction, std

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """The same for 1 m segments centred at (x, y). (n,) float64 each."""
        x, y, heading = (
            np.ascontiguousarray(a, dtype=np.float64).ravel() for a in np.broadcast_arrays(x, y, heading_rad)
        )
        code = self._robot(heightmap, robot)
        basis = heading_basis(heading, self.net.config.order)
        width = np.full(heading.size, robot.width_m)
        rest, spread = np.empty(heading.size), np.empty(heading.size)
        for k in range(0, heading.size, _BATCH):
            part = slice(k, k + _BATCH)
            squares = cut_squares(heightmap, x[part], y[part], size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M)
            tracks = track_features(squares, heading[part], width[part])
            rest[part], spread[part] = self._ask(squares, basis[part], tracks, code)
        gain, climb = (float(g) for g in code.gains[0])
        over_weight = gain * robot.rolling_resistance + climb * tan_grade(heightmap, x, y, heading) + rest
        traction = np.asarray(robot.weight_n * over_weight)
        price = robot.price_per_m(traction)
        return traction, segment_std(price, np.exp(spread), self._level_j(robot), factor=self.spread.factor)

    @torch.inference_mode()
    def _robot(self, heightmap: Heightmap, robot: Robot) -> RobotCode:
        return self.net.read_robot(torch.from_numpy(robot_features(robot, heightmap.resolution_m))[None])

    @staticmethod
    def _known(code: RobotCode, robot: Robot) -> NDArray[np.float64]:
        """What physics says over the weight: a mu and c; and the weight [N]."""
        gain, climb = (float(g) for g in code.gains[0])
        return np.array([gain * robot.rolling_resistance, climb, robot.weight_n])

    @staticmethod
    def _level_j(robot: Robot) -> float:
        return robot.hotel_per_m + robot.weight_n * robot.rolling_resistance

    @torch.inference_mode()
    def _series(self, slopes: NDArray[np.float32], code: RobotCode) -> NDArray[np.float32]:
        """Series of the head's units at cells 1 m apart, (rows, cols, units * C), of (8 rows + 8, 8 cols + 8, 3)."""
        series = self.net.read_ground(torch.from_numpy(slopes).permute(2, 0, 1)[None], code)
        return np.ascontiguousarray(series[0].permute(1, 2, 0).numpy())

    @torch.inference_mode()
    def _ask(
        self, squares: NDArray[np.float32], basis: NDArray[np.float32], tracks: NDArray[np.float32], code: RobotCode
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(r, logarithm of the relative spread) of single segments."""
        series = self.net.read_ground(slopes_of_squares(torch.from_numpy(squares)), code)[:, :, 0, 0]
        rest, spread = self.net.ask(series, torch.from_numpy(basis), torch.from_numpy(tracks), code)
        return rest.numpy(), spread.numpy()


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


def height_raster(heightmap: Heightmap, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights [m] at the working pixels of cells 1 m apart.

    x (cols,) ascending and y (rows,) descending : centres [m]. Returns (8 rows + 9, 8 cols + 9) float64: kilometres
    above the sea leave float32 no room for a tenth of a millimetre.
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
    return _resample(np.ascontiguousarray(heights), row, col)


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
def _resample(heights, row, col):  # fmt: skip
    out = np.empty((row.size, col.size))
    left = np.empty(col.size, dtype=np.int64)
    right = np.empty(col.size, dtype=np.int64)
    share = np.empty(col.size)
    for j in range(col.size):
        left[j], right[j], share[j] = _between(col[j], heights.shape[1])
    for i in range(row.size):
        up, down, low = _between(row[i], heights.shape[0])
        for j in range(col.size):
            upper = heights[up, left[j]] + share[j] * (float(heights[up, right[j]]) - heights[up, left[j]])
            lower = heights[down, left[j]] + share[j] * (float(heights[down, right[j]]) - heights[down, left[j]])
            out[i, j] = upper + low * (lower - upper)
    return out


@njit(cache=True, nogil=True)
def slopes_of(heights):  # fmt: skip
    """Rise to the east and to the north and the twist of every 2 x 2 heights [m]: (r, c) -> (r - 1, c - 1, 3)."""
    out = np.empty((heights.shape[0] - 1, heights.shape[1] - 1, 3), dtype=np.float32)
    scale = 0.5 / PIXEL_M
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            nw, ne = heights[i, j], heights[i, j + 1]
            sw, se = heights[i + 1, j], heights[i + 1, j + 1]
            out[i, j, 0] = ((ne - nw) + (se - sw)) * scale
            out[i, j, 1] = ((nw - sw) + (ne - se)) * scale
            out[i, j, 2] = ((ne - nw) - (se - sw)) * scale
    return out
