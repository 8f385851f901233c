"""Smoothed positions and their velocities: local straight lines in time; and whether smoothing does good."""

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

_OF_NOISE = -0.4
"""Correlation of bends to the side, between -1/2 and -1/4: see `cuts_corners`."""


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


def position_noise(x: FloatArray, y: FloatArray, moved: NDArray[np.bool_]) -> float:
    """Return the noise of single fixes, from how three in a row leave a straight line.

    `x`, `y` (k,): fixes [m]; `moved` (k - 1,): whether each differs from the one before. Result: standard deviation
    [m].
    """
    fresh = np.concatenate([[True], moved])
    if fresh.sum() < 4:
        return 0.0
    bends = np.concatenate([np.diff(values[fresh], 2) for values in (x, y)])
    return 1.4826 * float(np.median(np.abs(bends))) / math.sqrt(6.0)


def cuts_corners(x: FloatArray, y: FloatArray, between: NDArray[np.bool_]) -> bool:
    """Return whether smoothing over one interval shortens the way between fixes by more than their noise lengthens it.

    Noise n of fixes makes steps d longer by n^2 / d, and smoothing leaves exp(-theta^2 / 2) of the radius of a curve
    that turns by theta in a step. Bends to the side, d theta, have a correlation of -2/3 with the next one where they
    are noise, and of 0 to 1 in curves. Where n^2 / d is d theta^2 / 2 it is -1/2 for turns of one step, and -1/4 for
    longer ones.

    `x`, `y` (k,): fixes [m]; `between` (k - 1,): where the track breaks before the next.
    """
    step_x, step_y = np.diff(x), np.diff(y)
    whole = ~between & ((step_x != 0) | (step_y != 0))
    chord = np.hypot(step_x[1:] + step_x[:-1], step_y[1:] + step_y[:-1])
    turned = step_x[:-1] * step_y[1:] - step_y[:-1] * step_x[1:]
    bend = np.where(whole[1:] & whole[:-1] & (chord > 0), 2.0 * turned / np.where(chord > 0, chord, 1.0), 0.0)
    return bool(bend.any() and (bend[1:] * bend[:-1]).sum() > _OF_NOISE * (bend**2).sum())
