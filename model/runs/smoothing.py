"""Smoothed positions and their velocities: local straight lines in time."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SMOOTHING_S = 0.3
"""Positions are smoothed over so long, or over one interval of the fixes where that is longer."""

MOST_SMOOTHED = 1000
"""Most rows that a smoothed position is made of; where more lie that near in time, every second, third or later one."""


@njit(cache=True)
def smooth(
    t: FloatArray, x: FloatArray, y: FloatArray, piece: NDArray[np.int64], sigma_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit local straight lines in time with Gaussian weights, never across pieces.

    `t`, `x`, `y` (n,): stamps [s], which increase, and positions [m]; `piece` (n,): number of the piece. Result (n,):
    x, y [m] and their velocities [m/s].
    """
    n = t.size
    sx, sy, vx, vy = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    reach = 3.0 * sigma_s + 1e-6  # rounding must not take one side's last sample
    first = last = 0
    for k in range(n):
        while piece[first] != piece[k] or t[k] - t[first] > reach:
            first += 1
        last = max(last, k)
        while last + 1 < n and piece[last + 1] == piece[k] and t[last + 1] - t[k] <= reach:
            last += 1
        stride = 1 + (last - first) // MOST_SMOOTHED
        w0 = w1 = w2 = x0 = x1 = y0 = y1 = 0.0
        for side in (-1, 1):
            j = k if side == 1 else k - stride
            while first <= j <= last:
                dt = t[j] - t[k]
                w = math.exp(-0.5 * (dt / sigma_s) ** 2)
                w0 += w
                w1 += w * dt
                w2 += w * dt * dt
                x0 += w * (x[j] - x[k])
                x1 += w * dt * (x[j] - x[k])
                y0 += w * (y[j] - y[k])
                y1 += w * dt * (y[j] - y[k])
                j += side * stride
        det = w0 * w2 - w1 * w1
        if det > 1e-12:
            sx[k] = x[k] + (w2 * x0 - w1 * x1) / det
            sy[k] = y[k] + (w2 * y0 - w1 * y1) / det
            vx[k] = (w0 * x1 - w1 * x0) / det
            vy[k] = (w0 * y1 - w1 * y0) / det
        else:
            sx[k], sy[k] = x[k], y[k]
    return sx, sy, vx, vy
