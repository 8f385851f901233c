"""How large the noise of a survey is, from its heights alone."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame

FloatArray = NDArray[np.float32]

_WINDOW_CELLS, _WINDOWS = 96, 4
"""A large map is judged by 4 x 4 windows of so many cells a side."""
_LEAST_KNOWN = 256
"""Fewer known twists say nothing of the noise."""
_SIDES = (1, 2, 4)
_LEAST_GROWTH = 4.0
"""Of the variance of twists of ground when their side doubles: that of random slopes; smooth ground has 16."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


class _Surveyed(Protocol):
    """What a survey is asked for: a `Ground`."""

    @property
    def frame(self) -> GridFrame:
        """Where the grid lies."""

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Any:
        """A `Heightmap` of some of its cells."""


def estimated_noise_m(ground: _Surveyed) -> float:
    """Return the standard deviation of the noise of a map of any size [m], from windows spread over it."""
    (rows, cols), side = ground.frame.shape, _WINDOW_CELLS
    if rows * cols <= (_WINDOWS * side) ** 2:
        return noise_of(ground.window(0, rows, 0, cols).heights) or 0.0
    starts = [np.unique(np.linspace(0, max(size - side, 0), _WINDOWS).astype(int)).tolist() for size in (rows, cols)]
    found = [
        noise_of(ground.window(row, min(row + side, rows), col, min(col + side, cols)).heights)
        for row in starts[0]
        for col in starts[1]
    ]
    return float(np.median([noise for noise in found if noise is not None] or [0.0]))


def noise_of(heights: FloatArray) -> float | None:
    """Return the standard deviation of the noise of a survey [m], from its heights (rows, cols) alone.

    The twist of the four corners of a square has the variance of the noise at any side, plus that of the ground, which
    grows by some factor from each side to its double (for a power law always by the same one, and at least by
    `_LEAST_GROWTH`). Three sides give both. Twists see hardly anything of hills, edges and furrows. Ground that is as
    rough below a cell as above counts as noise: such a map cannot tell them apart. NaN is unknown; None where too
    little is known. Standard deviations are robust (median absolute deviation; Donoho & Johnstone 1994).
    """
    reach = _SIDES[-1]
    if min(heights.shape) <= reach:
        return None
    rows, cols = (size - reach for size in heights.shape)
    variances = []
    for side in _SIDES:
        corners = [heights[i : rows + i, j : cols + j] for i in (0, side) for j in (0, side)]
        twist = np.abs(corners[0] - corners[1] - corners[2] + corners[3])
        twist = twist[~np.isnan(twist)]
        if twist.size < _LEAST_KNOWN:
            return None
        variances.append((0.5 * _NORMAL * float(np.median(twist))) ** 2)
    one, two, four = variances
    if two <= one:
        return math.sqrt(one)
    growth = max((four - two) / (two - one), _LEAST_GROWTH)
    return math.sqrt(max(one - (two - one) / (growth - 1.0), 0.0))
