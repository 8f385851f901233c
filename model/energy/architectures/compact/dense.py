"""The compact network over a map: whole windows in dense passes, single segments by their squares, one answer."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from joulemap.model.energy.architectures.compact.ground import Scratch, read_ground, slopes_of_squares
from joulemap.model.energy.architectures.compact.head import Headings, answer_tile
from joulemap.model.energy.architectures.compact.raster import Buffers, read_cells
from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, REACH_M, SQUARE, track_features
from joulemap.model.energy.architectures.compact.weights import CompactWeights, RobotWeights, heading_basis
from joulemap.model.energy.drivetrain import changes, geared
from joulemap.model.energy.grade import tan_grade, tan_grade_lattice
from joulemap.model.energy.learned import Facts, Learned
from joulemap.model.energy.robot_features import robot_features
from joulemap.model.energy.uncertainty import segment_std
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_squares
from joulemap.model.threads import share_out

FloatArray = NDArray[np.float64]

_JOINED_TILE = 24, 64  # cells of one pass: its layers stay near the cache
_SQUARES_TILE = 6, 64
_SQUARES_SPAN_M = 128.0  # at most, for the sake of memory
_BATCH = 2048  # squares of one pass
_PASSES = 8  # a spacing of 1/k m up to this k is answered by k x k passes over cells at a spacing of 1 m


class CompactPredictor(Learned):
    """Traction demand and its uncertainty from a trained compact network.

    A cell is NaN where the 2 m square around it touches an unknown height. At the edge of the map the ground is
    continued by odd reflection (a plane stays a plane), so that edge cells have an answer.
    """

    def __init__(self, weights: CompactWeights, facts: Facts) -> None:
        super().__init__(facts)
        self.weights = weights

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return traction and uncertainty at the cell centres of a lattice.

        Cells at a spacing of 1, 1/2, 1/3 ... 1/8 m share what is read of the ground; at any other spacing each cell
        reads its own.

        `headings_rad` is (K,). Returns `traction` (rows, cols, K): traction demand [J/m], NaN where the map is unknown;
        `std` (rows, cols, K): standard deviation of a 1 m segment's energy [J].
        """
        headings_rad = np.ascontiguousarray(headings_rad, dtype=np.float64)
        traction = tan_grade_lattice(heightmap, frame, headings_rad)  # (rows, cols, K), turned into traction below
        std = np.empty_like(traction)
        weights = self._weights(heightmap, robot)
        headings = Headings.of(headings_rad, heading_basis(headings_rad, self.weights.config.order), robot.width_m)
        gain, climb = weights.gains
        known = np.array([gain * robot.rolling_resistance, climb, robot.weight_n])  # a mu and c, and the weight [N]
        price = np.array([robot.hotel_per_m, robot.regeneration, self._level_j(robot), self.spread.factor])
        x, y = frame.centres()
        step = round(1.0 / frame.resolution_m)
        joined = 1 <= step <= _PASSES and abs(step * frame.resolution_m - 1.0) < 1e-9
        step, (high, wide) = (step, _JOINED_TILE) if joined else (1, _SQUARES_TILE)
        if not joined:
            high, wide = (max(1, min(n, int(_SQUARES_SPAN_M / frame.resolution_m))) for n in (high, wide))
        mine = threading.local()

        def _fill(at: tuple[int, int]) -> None:
            if not hasattr(mine, "buffers"):
                mine.buffers = Buffers.of(high, wide, joined=joined)
                mine.scratch = Scratch.of(high, wide, weights, joined=joined)
            rows = y[at[0] : at[0] + high * step : step]
            cols = x[at[1] : at[1] + wide * step : step]
            heights, slopes = read_cells(heightmap, cols, rows, mine.buffers, joined=joined)
            answer_tile(
                heights,
                read_ground(slopes, weights, mine.scratch),
                headings.basis,
                headings.stencil,
                headings.back,
                headings.own,
                headings.per_width,
                weights.head,
                known,
                price,
                (*at, step, rows.size, cols.size),
                traction,
                std,
            )

        tiles = [
            (top, left)
            for i in range(min(step, frame.rows))
            for j in range(min(step, frame.cols))
            for top in range(i, frame.rows, high * step)
            for left in range(j, frame.cols, wide * step)
        ]
        with threadpool_limits(1, user_api="blas"):  # a tile per thread, nothing shared inside a tile
            share_out(_fill, tiles)
        geared_by, kinds = self.drivetrain_efficiency, heightmap.layers
        if not kinds.kinds and not changes(robot, geared_by):
            return traction, std
        std /= self._varying(robot, traction)  # the tiles know the network's own price only
        traction = kinds.on_kinds(geared(traction, robot, geared_by), robot, x[None, :, None], y[:, None, None])
        std *= self._varying(robot, traction)
        return traction, std

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return traction and uncertainty of 1 m segments.

        `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,). Returns `traction` (n,): traction demand [J/m],
        NaN where the map is unknown; `std` (n,): standard deviation of the energy [J].
        """
        x, y, heading = (
            np.ascontiguousarray(a, dtype=np.float64).ravel() for a in np.broadcast_arrays(x, y, heading_rad)
        )
        weights = self._weights(heightmap, robot)
        basis = heading_basis(heading, self.weights.config.order)
        width = np.full(heading.size, robot.width_m)
        rest, spread = np.empty(heading.size), np.empty(heading.size)
        for k in range(0, heading.size, _BATCH):
            part = slice(k, k + _BATCH)
            squares = cut_squares(heightmap, x[part], y[part], size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M)
            tracks = track_features(squares, heading[part], width[part])
            scratch = Scratch.of(1, len(squares), weights, joined=False)
            series = read_ground(slopes_of_squares(squares), weights, scratch)
            rest[part], spread[part] = weights.ask(series, basis[part], tracks)
        gain, climb = weights.gains
        over_weight = gain * robot.rolling_resistance + climb * tan_grade(heightmap, x, y, heading) + rest
        traction = geared(np.asarray(robot.weight_n * over_weight), robot, self.drivetrain_efficiency)
        traction = heightmap.layers.on_kinds(traction, robot, x, y)
        return traction, self.spread.factor * np.exp(spread) * self._varying(robot, traction)

    def _weights(self, heightmap: Heightmap, robot: Robot) -> RobotWeights:
        return self.weights.for_robot(robot_features(robot, heightmap.resolution_m, heightmap.removed_noise_m))

    def _varying(self, robot: Robot, traction: NDArray[Any]) -> NDArray[Any]:
        """Energy [J] with which the standard deviation of a segment goes, in the shape of `traction` [J/m]."""
        size = segment_std(robot.price_per_m(traction), 1.0, self._level_j(robot), factor=1.0)
        return np.maximum(size, np.finfo(np.float32).tiny).astype(traction.dtype)

    @staticmethod
    def _level_j(robot: Robot) -> float:
        return robot.hotel_per_m + robot.weight_n * robot.rolling_resistance
