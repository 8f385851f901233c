"""How large the noise of a survey is, and how far it is alike, from its heights alone.

The twist of the four corners of a square sees hardly anything of hills, edges and furrows. Its variance grows with the
side of the square: that of ground always, that of noise up to twice the length over which it is alike.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.correlated_noise import PossibleNoise, correlated_noise

FloatArray = NDArray[np.float32]

_WINDOW_CELLS, _WINDOWS = 96, 4
"""A large map is judged by 4 x 4 windows of so many cells a side."""
_LEAST_KNOWN = 256
"""Fewer known twists say nothing of the noise."""
_SIDES = (1, 2, 4, 6, 8, 12, 16, 24, 32)
_FINEST = 3
"""The first so many sides tell noise that is independent from cell to cell."""
_LEAST_GROWTH = 4.0
"""Of the variance of twists of ground when their side doubles: that of random slopes; smooth ground has 16."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, slots=True)
class SurveyNoise:
    """The noise of a survey, given or estimated."""

    noise_m: float = 0.0  # Its standard deviation [m]; of bumps that are perhaps noise the square root of their
    # variance times that probability, so that as much of them is taken out
    length_m: float = 0.0  # Its correlation at distance d is exp(-d^2 / 2 l^2) [m]; 0: independent from cell to cell
    bumps: PossibleNoise | None = None  # What has the shape of noise, and may be ground


class Surveyed:
    """What a heightmap, whole or in a file, knows of its noise."""

    frame: GridFrame
    given_noise_m: float | None
    given_noise_length_m: float

    @abstractmethod
    def window(self, row0: int, row1: int, col0: int, col1: int) -> Any:
        """Return the heights of some of its cells.

        Parameters
        ----------
        row0, row1, col0, col1 : int
            The cells [row0, row1) x [col0, col1).

        Returns
        -------
        Heightmap
            That part of the map.
        """
        raise NotImplementedError

    @cached_property
    def noise(self) -> SurveyNoise:
        """The noise of the survey, given or estimated."""
        if self.given_noise_m is None:
            return estimated_noise(self)
        return SurveyNoise(self.given_noise_m, self.given_noise_length_m)

    @property
    def noise_m(self) -> float:
        """Standard deviation of the noise of the survey [m], given or estimated."""
        return self.noise.noise_m

    @property
    def noise_length_m(self) -> float:
        """Length over which it is alike [m], given or estimated; 0 where it is independent from cell to cell."""
        return self.noise.length_m


def sample_windows(frame: GridFrame, side: int, number: int) -> list[tuple[int, int, int, int]]:
    """Return parts of a map that speak for it all: (row0, row1, col0, col1), the whole of a small one.

    `side`: of a part [cells]; `number`: of parts along each side of the map.
    """
    rows, cols = frame.shape
    if rows * cols <= (number * side) ** 2:
        return [(0, rows, 0, cols)]
    starts = [np.unique(np.linspace(0, max(size - side, 0), number).astype(int)).tolist() for size in (rows, cols)]
    return [(row, min(row + side, rows), col, min(col + side, cols)) for row in starts[0] for col in starts[1]]


def estimated_noise(ground: Surveyed) -> SurveyNoise:
    """Return the noise of a map of any size, from windows spread over it."""
    windows, cells_m = sample_windows(ground.frame, _WINDOW_CELLS, _WINDOWS), ground.frame.resolution_m
    found = [twists for window in windows if len(twists := twists_of(ground.window(*window).heights)) >= _FINEST]
    if not found:
        return SurveyNoise()
    independent = SurveyNoise(float(np.median([independent_noise_m(twists[:, 0]) for twists in found])))
    count = min(len(twists) for twists in found)
    each = np.array([twists[:count] for twists in found])  # (windows, sides, 3)
    variances, squares, tails = np.median(each[..., 0], axis=0), each[..., 1].sum(axis=0), np.median(each[..., 2], 0)
    bumps = correlated_noise(np.array(_SIDES[:count], dtype=float), variances, squares, tails, cells_m)
    if bumps is None:
        return independent
    counts_m = math.sqrt(bumps.probability) * bumps.std_m
    if counts_m > independent.noise_m:
        return SurveyNoise(counts_m, bumps.length_m, bumps)
    return replace(independent, bumps=bumps)


def twists_of(heights: FloatArray) -> NDArray[np.float64]:
    """Return for each side of `_SIDES` the variance of half the twists [m2], their number, and how heavy their tails
    are: the ninth decile of their size over their median.

    `heights` (rows, cols), NaN where unknown; result (sides, 3), of the sides that the map holds four of and that
    enough is known for. Robust (median absolute deviation; Donoho & Johnstone 1994). Wide squares overlap much, so not
    all of them are used.
    """
    rows, cols = heights.shape
    found: list[tuple[float, int, float]] = []
    for side in _SIDES:
        reach, step = max(side, _SIDES[_FINEST - 1]), max(side // 4, 1)
        if min(rows, cols) < (4 * side if len(found) >= _FINEST else reach + 1):
            break
        a, b, c, d = (
            heights[i : rows - reach + i : step, j : cols - reach + j : step] for i in (0, side) for j in (0, side)
        )
        twist = np.abs(a - b - c + d)
        twist = twist[~np.isnan(twist)]
        if twist.size * step**2 < _LEAST_KNOWN:
            break
        half, tail = twist.size // 2, twist.size * 9 // 10
        twist.partition(half)  # one at a time: several times as fast as both at once
        median, upper = float(twist[half]), twist[half:]
        upper.partition(tail - half)
        decile = float(twist[tail])
        found.append(((0.5 * _NORMAL * median) ** 2, twist.size * step**2, decile / max(median, 1e-12)))
    return np.array(found).reshape(-1, 3)


def independent_noise_m(variances: NDArray[np.float64]) -> float:
    """Return the standard deviation [m] of noise that is independent from cell to cell.

    `variances` (n,): of the twists of squares of 1, 2 and 4 cells, and more that do not count [m2].

    Such noise has the same variance at any side, and that of ground grows by some factor from each side to its double
    (for a power law always by the same one, and at least by `_LEAST_GROWTH`). Three sides give both. Ground that is as
    rough below a cell as above counts as noise: such a map cannot tell them apart.
    """
    one, two, four = (float(variance) for variance in variances[:_FINEST])
    if two <= one:
        return math.sqrt(one)
    growth = max((four - two) / (two - one), _LEAST_GROWTH)
    return math.sqrt(max(one - (two - one) / (growth - 1.0), 0.0))
