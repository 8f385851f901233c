"""The compact network's ground part over the cells of a tile, compiled: `CompactNet.read_ground` without torch.

A raster lies in memory by row, plane, channel and lane. A lane is a cell, and the planes are the columns of one cell:
column c of lane j is column `planes` j + c of the raster. What a convolution with stride 2 multiplies is then a matrix
of whole runs of lanes, which BLAS multiplies with the weights. All convolutions are unpadded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg.cython_blas  # noqa: F401  numba's products are its; loaded before anybody limits its threads
from numba import njit
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, SQUARE
from joulemap.model.energy.architectures.compact.weights import KERNELS, STRIDE, RobotWeights

FloatArray = NDArray[np.float32]

_AT_ONCE = 256
"""About so many columns has a matrix of one product: it stays in the cache."""


@dataclass(frozen=True)
class Scratch:
    """Memory for `read_ground`, all of it flat."""

    gathered: FloatArray  # The inputs of a layer as a matrix, its answers, and those of the hidden layer
    sums: FloatArray
    hidden: FloatArray
    first: FloatArray  # The first two convolutions' answers
    second: FloatArray

    @classmethod
    def of(cls, rows: int, cols: int, weights: RobotWeights, *, joined: bool) -> Scratch:
        """Reserve memory for tiles."""
        outputs, inputs = ([weight.shape[axis] for weight in weights.ground[::2]] for axis in (0, 1))
        high, planes, slots = (STRIDE * rows + STRIDE, STRIDE, cols + 2) if joined else (SQUARE - 1, SQUARE - 1, cols)
        answers, columns = [], []
        for kernel, width in zip(KERNELS, outputs, strict=False):
            high, planes = (high - kernel) // 2 + 1, planes // 2 if joined else (planes - kernel) // 2 + 1
            answers.append(high * planes * width * slots)
            columns.append(max(_AT_ONCE, planes * slots))
        last = columns[-1]
        sizes = (
            max(inputs[0] * columns[0], inputs[1] * columns[1], inputs[2] * last, outputs[4] * last),
            max(outputs[0] * columns[0], outputs[1] * columns[1], outputs[2] * last),
            outputs[3] * last,
            *answers[:2],
        )
        return cls(*(np.zeros(size, dtype=np.float32) for size in sizes))


def slopes_of_squares(squares: FloatArray) -> FloatArray:
    """Return the slopes of every 2 x 2 heights of squares, as `read_ground` takes them.

    `squares` (n, N, N): heights [m] at working pixels, north up. Result (1, N - 1, N - 1, 3, n): slope to the east,
    slope to the north and twist.
    """
    heights = np.ascontiguousarray(squares.transpose(1, 2, 0))  # (N, N, n)
    nw, ne, sw, se = heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:]
    above, below = ne - nw, se - sw
    slopes = np.stack([above + below, (nw - sw) + (ne - se), above - below], axis=2)
    return (slopes * np.float32(0.5 / PIXEL_M))[None]


def read_ground(slopes: FloatArray, weights: RobotWeights, scratch: Scratch) -> FloatArray:
    """Read the ground: a Fourier series over headings for every hidden unit of the head.

    `slopes` (rasters, rows, planes, 3, lanes): as from `raster.read_cells`, or from `slopes_of_squares`. Result (units
    * (2 order + 1), places): places in order of rows, then columns. NaN where a slope is.
    """
    rasters, high, planes, _, slots = slopes.shape
    cols = slots - 2 if planes == STRIDE else slots
    series = np.empty((weights.ground[-1].size, rasters * (high // STRIDE - 1) * cols), dtype=np.float32)
    _read(
        slopes,
        weights.ground,
        scratch.gathered,
        scratch.sums,
        scratch.hidden,
        scratch.first,
        scratch.second,
        series,
    )
    return series


@njit(cache=True, nogil=True)
def _read(slopes, weights, gathered, sums, hidden, first, second, series):
    slots = slopes.shape[4]
    joined = slopes.shape[2] == STRIDE  # neighbouring cells share columns, so that the last lane has a neighbour
    cols, lanes = (slots - 2, slots - 1) if joined else (slots, slots)
    rows1, planes1 = _answers(slopes.shape[1], slopes.shape[2], KERNELS[0], joined)
    rows2, planes2 = _answers(rows1, planes1, KERNELS[1], joined)
    rows3 = _answers(rows2, planes2, KERNELS[2], joined)[0]
    shape1, shape2 = (rows1, planes1, weights[0].shape[0], slots), (rows2, planes2, weights[2].shape[0], slots)
    one = first[: shape1[0] * shape1[1] * shape1[2] * slots].reshape(shape1)
    two = second[: shape2[0] * shape2[1] * shape2[2] * slots].reshape(shape2)
    for raster in range(slopes.shape[0]):
        _convolve(slopes[raster], KERNELS[0], lanes, weights[0], weights[1], gathered, sums, one)
        _convolve(one, KERNELS[1], lanes, weights[2], weights[3], gathered, sums, two)
        _describe(two, rows3, cols, weights, gathered, sums, hidden, series, raster * rows3 * cols)


@njit(cache=True, nogil=True)
def _answers(rows, planes, kernel, joined):
    """Rows and planes of the answers of a convolution."""
    return (rows - kernel) // 2 + 1, planes // 2 if joined else (planes - kernel) // 2 + 1


@njit(cache=True, nogil=True)
def _convolve(x, kernel, lanes, weight, bias, gathered, sums, out):
    """A convolution with its bias, below zero cut off, of (rows, planes, channels, slots)."""
    rows, planes = out.shape[:2]
    at_once = max(1, _AT_ONCE // (planes * lanes))
    for start in range(0, rows, at_once):
        count = min(at_once, rows - start)
        columns = count * planes * lanes
        inputs, answers = _matrix(gathered, weight.shape[1], columns), _matrix(sums, weight.shape[0], columns)
        _gather(x, kernel, start, count, planes, lanes, inputs)
        np.dot(weight, inputs, answers)
        _rectify(answers, bias)
        for v in range(weight.shape[0]):
            for i in range(count):
                for plane in range(planes):
                    of, to = answers[v, (i * planes + plane) * lanes :], out[start + i, plane, v]
                    for b in range(lanes):
                        to[b] = of[b]


@njit(cache=True, nogil=True)
def _describe(x, rows, cols, weights, gathered, sums, hidden, series, at):
    """The third convolution, the hidden layer and the series of rows x cols cells, from column `at` of `series` on."""
    at_once = max(1, _AT_ONCE // cols)
    for start in range(0, rows, at_once):
        count = min(at_once, rows - start) * cols
        inputs, third = _matrix(gathered, weights[4].shape[1], count), _matrix(sums, weights[4].shape[0], count)
        _gather(x, KERNELS[2], start, count // cols, 1, cols, inputs)
        np.dot(weights[4], inputs, third)
        _rectify(third, weights[5])
        units, terms = _matrix(hidden, weights[6].shape[0], count), _matrix(gathered, weights[8].shape[0], count)
        np.dot(weights[6], third, units)
        _rectify(units, weights[7])
        np.dot(weights[8], units, terms)
        for v in range(terms.shape[0]):
            of, to = terms[v], series[v, at + start * cols :]
            for b in range(count):
                to[b] = of[b] + weights[9][v]


@njit(cache=True, nogil=True)
def _matrix(flat, rows, cols):
    return flat[: rows * cols].reshape(rows, cols)


@njit(cache=True, nogil=True)
def _gather(x, kernel, start, rows, planes, lanes, out):
    """What is multiplied with the weights of some rows of answers: (inputs, rows * planes * lanes)."""
    n, wide = 0, x.shape[1]
    for channel in range(x.shape[2]):
        for down in range(kernel):
            for right in range(kernel):
                for i in range(rows):
                    for plane in range(planes):
                        col = 2 * plane + right
                        of = x[2 * (start + i) + down, col % wide, channel, col // wide :]
                        to = out[n, (i * planes + plane) * lanes :]
                        for b in range(lanes):
                            to[b] = of[b]
                n += 1


@njit(cache=True, nogil=True)
def _rectify(answers, bias):
    """Add the bias and cut off what is below zero; what is unknown stays unknown."""
    zero = np.float32(0.0)
    for v in range(answers.shape[0]):
        row, more = answers[v], bias[v]
        for b in range(row.size):
            answer = row[b] + more
            row[b] = zero if answer < zero else answer
