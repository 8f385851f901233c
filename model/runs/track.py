"""From stamps and positions to a track: smoothed, in pieces, with headings, speeds and stands, and cut into chords."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_of, wrap_angle
from joulemap.model.runs.reader import Run

FloatArray = NDArray[np.float64]

TURN_LIMITS_RADPS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)
"""Limits up to which a gentle turn counts how fast a robot turns."""
SMOOTHING_S = 0.3
"""Positions are smoothed over so long, or over one interval of the fixes where that is longer."""

_TRACK_HEADING_S = 0.5  # directions need more smoothing than places
_COMPASS_AGREES_RAD = 0.25
_STANDS_WITHIN_M = 0.05
_STANDS_EVENLY = 0.25


def track_headings(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, speed: FloatArray
) -> FloatArray:
    """Where the robot points [rad] at the rows `good`: its `heading` column where that agrees with the track, which it
    knows better than positions do; else the direction of the track.
    """
    t, x, y = run.t[good], run.x[good], run.y[good]
    _, _, vx, vy = smooth(t, x, y, piece, max(_TRACK_HEADING_S, interval))
    track = heading_of(vx, vy)
    compass = run.extras.get("heading")
    if compass is None or np.isfinite(compass[good]).mean() < 0.8:
        return track
    known = np.isfinite(compass)
    turns = np.unwrap(np.radians(compass[known]))
    pointed = np.interp(t, run.t[known], turns)
    clear = speed > 0.5 * float(np.quantile(speed, 0.9))
    if np.median(np.abs(wrap_angle(pointed - track)[clear])) > _COMPASS_AGREES_RAD:
        return track
    north, east, _, _ = smooth(t, np.cos(pointed), np.sin(pointed), piece, max(SMOOTHING_S, interval))
    return heading_of(east, north)


def turns_between(t: FloatArray, heading: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heading change between fractional positions, followed through every sample: signed (> 0 to the right), absolute,
    and absolute with every rate up to the limits only (n, limits).
    """
    step, dt = wrap_angle(np.diff(heading)), np.diff(t)
    station = np.arange(t.size, dtype=np.float64)

    def between(steps: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(ends[:, 1], station, total) - np.interp(ends[:, 0], station, total)

    gentle = [between(np.minimum(np.abs(step), limit * dt)) for limit in TURN_LIMITS_RADPS]
    return between(step), between(np.abs(step)), np.stack(gentle, axis=1)


def track_speeds(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, track: FloatArray
) -> FloatArray:
    """Speed at the rows `good` [m/s]: the `speed` column, evened out, where it agrees with the track; else its."""
    logged = run.extras.get("speed")
    if logged is None or np.isfinite(logged[good]).mean() < 0.8:
        return track
    known = np.isfinite(logged)
    told = np.interp(run.t[good], run.t[known], logged[known])
    if np.median(np.abs(told - track)) > 0.2 * float(np.median(track)):
        return track
    return smooth(run.t[good], told, told, piece, max(SMOOTHING_S, interval))[0]


def find_stands(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    piece: NDArray[np.int64],
    stamps: FloatArray,
    power: FloatArray,
    speed: FloatArray | None,
) -> tuple[tuple[int, float, float], ...]:
    """(0, seconds, energy) of every stand, without its first and last half second. The robot stays where it is and
    draws evenly and little: one that turns on the spot, or that lost its position on the way, is not standing.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[1], (piece != 0).astype(int), [1]])))
    usual = float(np.median(power))
    found = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        start, end = float(t[first]) + 0.5, float(t[after - 1]) - 0.5
        rows = (stamps >= start) & (stamps <= end)
        drawn = power[rows]
        if end - start < 1.0 or drawn.size < 5 or drawn.std() > _STANDS_EVENLY * drawn.mean() > 0:
            continue
        moved = math.hypot(x[after - 1] - x[first], y[after - 1] - y[first])
        told = 0.0 if speed is None else float(np.nan_to_num(np.abs(speed[rows])).mean())
        if moved < _STANDS_WITHIN_M and told < _STANDS_WITHIN_M and 0.0 < drawn.mean() < 0.7 * usual:
            ends = integral(stamps, power, np.array([start, end]))
            found.append((0, end - start, float(ends[1] - ends[0])))
    return tuple(found)


@njit(cache=True)
def smooth(
    t: FloatArray, x: FloatArray, y: FloatArray, piece: NDArray[np.int64], sigma_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Local straight lines in time with Gaussian weights, never across pieces: position and velocity, (n,) each."""
    n = t.size
    sx, sy, vx, vy = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    reach = 3.0 * sigma_s + 1e-6  # rounding must not take one side's last sample
    for k in range(n):
        w0 = w1 = w2 = x0 = x1 = y0 = y1 = 0.0
        for side in (-1, 1):
            j = k if side == 1 else k - 1
            while 0 <= j < n and piece[j] == piece[k] and abs(t[j] - t[k]) <= reach:
                dt = t[j] - t[k]
                w = math.exp(-0.5 * (dt / sigma_s) ** 2)
                w0 += w
                w1 += w * dt
                w2 += w * dt * dt
                x0 += w * (x[j] - x[k])
                x1 += w * dt * (x[j] - x[k])
                y0 += w * (y[j] - y[k])
                y1 += w * dt * (y[j] - y[k])
                j += side
        det = w0 * w2 - w1 * w1
        if det > 1e-12:
            sx[k] = x[k] + (w2 * x0 - w1 * x1) / det
            sy[k] = y[k] + (w2 * y0 - w1 * y1) / det
            vx[k] = (w0 * x1 - w1 * x0) / det
            vy[k] = (w0 * y1 - w1 * y0) / det
        else:
            sx[k], sy[k] = x[k], y[k]
    return sx, sy, vx, vy


@njit(cache=True)
def pieces_of(
    t: FloatArray, speed: FloatArray, gap: NDArray[np.bool_], standing_mps: float, standing_s: float
) -> tuple[NDArray[np.int64], int]:
    """Number of the piece each sample belongs to (0 while standing for `standing_s` or more), and how many stands."""
    n = t.size
    piece = np.zeros(n, dtype=np.int64)
    now = 0
    stops = 0
    fresh = True
    k = 0
    while k < n:
        fresh = fresh or gap[k]
        if speed[k] < standing_mps:
            j = k
            while j + 1 < n and speed[j + 1] < standing_mps and not gap[j + 1]:
                j += 1
            if t[j] - t[k] >= standing_s:
                stops += 1
                fresh = True
                k = j + 1
                continue
        if fresh:
            now += 1
            fresh = False
        piece[k] = now
        k += 1
    return piece, stops


@njit(cache=True)
def cut_chords(x: FloatArray, y: FloatArray, piece: NDArray[np.int64], length: float) -> tuple[FloatArray, int]:
    """Fractional positions (n, 2) of p and q, `length` apart in a straight line, and the number of remainders."""
    n = x.size
    ends = np.empty((n + 1, 2))
    count = 0
    remainders = 0
    k = 0
    while k < n:
        if piece[k] == 0:
            k += 1
            continue
        here = piece[k]
        start = float(k)
        px, py = x[k], y[k]
        j = k + 1
        while j < n and piece[j] == here:
            if math.hypot(x[j] - px, y[j] - py) < length:
                j += 1
                continue
            ax, ay = x[j - 1] - px, y[j - 1] - py
            f0 = start - (j - 1) if start > j - 1 else 0.0
            dx, dy = x[j] - x[j - 1], y[j] - y[j - 1]
            a = dx * dx + dy * dy  # |a + f d| = length, the later root
            b = ax * dx + ay * dy
            c = ax * ax + ay * ay - length * length
            f = min(max((-b + math.sqrt(max(b * b - a * c, 0.0))) / a, f0), 1.0)
            end = j - 1 + f
            ends[count, 0] = start
            ends[count, 1] = end
            count += 1
            if count == ends.shape[0]:
                grown = np.empty((2 * count, 2))
                grown[:count] = ends
                ends = grown
            start = end
            px, py = x[j - 1] + f * dx, y[j - 1] + f * dy
        if start < j - 1:
            remainders += 1
        k = j
    return ends[:count].copy(), remainders


def integral(t: FloatArray, power: FloatArray, at: FloatArray) -> FloatArray:
    """Integral of piecewise linear `power` from t[0] to `at`, exactly."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    there = np.interp(at, t, power)
    return total[k] + 0.5 * (power[k] + there) * (at - t[k])
