"""What the two wheel tracks of a 1 m segment meet: nine numbers per place and heading, read off the heightmap itself.

A network that reads the ground around a place as a whole smears a bump over tens of degrees of heading; the wheels do
not. These numbers are sharp in heading, cheap (two lines of `SAMPLES` heights), and the same for a single segment and
for a whole lattice. Driving the other way swaps and reverses the lines, which changes only the grade and the rise.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from model.frames import heading_vector

PIXEL_M = 0.125
"""Side of a working pixel [m]: eight to the metre."""
SQUARE = 17
"""Heights along a side of the square that one answer sees: 16 pixels, 2 m."""
REACH_M = (SQUARE - 1) // 2 * PIXEL_M
"""How far around a place the network looks [m], along both axes."""
SAMPLES = 13
"""Heights along a track: from 0.75 m behind the middle of the segment to as far ahead."""
WIDEST_M = 1.3
"""Tracks of wider robots are taken this far apart: further, they would leave the square."""

TRACKS = ("grade", "cross_grade", "rise", "bend_125", "bend_250", "bend_375", "curvature", "roughness", "twist")
"""grade : least-squares slope of both tracks [1]. cross_grade : |right - left| over the width [1]. rise : sum of all
steps up [m]. bend_mmm : sum of |second differences| over that many millimetres [m]. curvature : ends minus the middle
[m], mean of both tracks. roughness : root mean square about each track's own line [m]. twist : difference of the two
tracks' climbs [m]. Each is divided by its entry of `TRACK_SCALES`."""
TRACK_SCALES = np.array([0.1, 0.1, 0.2, 0.2, 0.4, 0.5, 0.05, 0.02, 0.05], dtype=np.float32)
"""What brings each of `TRACKS` to about one on rough ground."""

_MIDDLE = (SAMPLES - 1) // 2


def track_stencil(heading_rad: NDArray[np.float64], width_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the samples lie, in working pixels from the middle: (2, SAMPLES, n, 2), left track first, (south, east)."""
    ahead_x, ahead_y = heading_vector(heading_rad)
    along = np.arange(SAMPLES)[:, None] - _MIDDLE
    aside = 0.5 * np.minimum(width_m, WIDEST_M) / PIXEL_M
    out = np.empty((2, SAMPLES, heading_rad.size, 2))
    for line, right in ((0, -aside), (1, aside)):
        out[line, :, :, 0] = -along * ahead_y + right * ahead_x
        out[line, :, :, 1] = along * ahead_x + right * ahead_y
    return out


def track_features(
    squares: NDArray[np.float32], heading_rad: NDArray[np.float64], width_m: NDArray[np.float64]
) -> NDArray[np.float32]:
    """`TRACKS`, scaled, of n segments: (n, 9) float32. squares : (n, 17, 17) [m]; heading_rad, width_m : (n,)."""
    out = np.empty((heading_rad.size, len(TRACKS)), dtype=np.float32)
    per_width = (1.0 / np.minimum(width_m, WIDEST_M)).astype(np.float32)
    _of_squares(squares, track_stencil(heading_rad, width_m), per_width, out)
    return out


@njit(cache=True, nogil=True)
def describe(lines, per_width, ahead, back):  # fmt: skip
    """Fill the nine numbers (9, n) of n places from their tracks (2, SAMPLES, n) [m], as driven ahead and as back."""
    samples, n = lines.shape[1:]
    middle = (samples - 1) // 2
    square = np.float32(middle * (middle + 1) * samples / 3.0)  # sum of (s - middle)^2
    mean, slope = np.zeros((2, n), dtype=np.float32), np.zeros((2, n), dtype=np.float32)
    rise, fall = np.zeros(n, dtype=np.float32), np.zeros(n, dtype=np.float32)
    bend, spread = np.zeros((3, n), dtype=np.float32), np.zeros(n, dtype=np.float32)
    for line in range(2):
        z = lines[line]
        for s in range(samples):
            along = np.float32(s - middle)
            for b in range(n):
                mean[line, b] += z[s, b]
                slope[line, b] += along * z[s, b]
        for b in range(n):
            mean[line, b] /= np.float32(samples)
            slope[line, b] /= square
        for s in range(samples):
            along = np.float32(s - middle)
            for b in range(n):
                out = z[s, b] - mean[line, b] - along * slope[line, b]
                spread[b] += out * out
        for s in range(samples - 1):
            for b in range(n):
                step = z[s + 1, b] - z[s, b]
                rise[b] += max(step, np.float32(0.0))
                fall[b] += max(-step, np.float32(0.0))
        for reach in range(1, 4):
            for s in range(reach, samples - reach):
                for b in range(n):
                    bend[reach - 1, b] += abs(z[s + reach, b] - np.float32(2.0) * z[s, b] + z[s - reach, b])
    left, right, half = lines[0], lines[1], np.float32(0.5)
    for b in range(n):
        ahead[0, b] = half * (slope[0, b] + slope[1, b]) / np.float32(PIXEL_M)
        ahead[1, b] = abs(mean[1, b] - mean[0, b]) * per_width[b]
        ahead[2, b] = rise[b]
        for reach in range(3):
            ahead[3 + reach, b] = bend[reach, b]
        ends = left[0, b] + left[-1, b] + right[0, b] + right[-1, b]
        ahead[6, b] = half * ends - left[middle, b] - right[middle, b]
        ahead[7, b] = math.sqrt(spread[b] / np.float32(2 * samples))
        ahead[8, b] = abs((right[-1, b] - right[0, b]) - (left[-1, b] - left[0, b]))
    for c in range(ahead.shape[0]):
        for b in range(n):
            ahead[c, b] /= TRACK_SCALES[c]
            back[c, b] = ahead[c, b]
    for b in range(n):
        back[0, b] = -ahead[0, b]
        back[2, b] = fall[b] / TRACK_SCALES[2]


@njit(cache=True, nogil=True)
def corner(offset):  # fmt: skip
    """The pixel below a fractional offset, and how far past it."""
    whole = math.floor(offset)
    return whole, offset - whole


@njit(cache=True, nogil=True)
def _of_squares(squares, stencil, per_width, out):  # fmt: skip
    middle = (SQUARE - 1) // 2
    lines = np.empty((2, SAMPLES, 1), dtype=np.float32)
    found, unused = np.empty((out.shape[1], 1), dtype=np.float32), np.empty((out.shape[1], 1), dtype=np.float32)
    for k in range(squares.shape[0]):
        for line in range(2):
            for s in range(SAMPLES):
                row, down = corner(stencil[line, s, k, 0])
                col, right = corner(stencil[line, s, k, 1])
                i, j = middle + row, middle + col
                upper = squares[k, i, j] + right * (squares[k, i, j + 1] - squares[k, i, j])
                lower = squares[k, i + 1, j] + right * (squares[k, i + 1, j + 1] - squares[k, i + 1, j])
                lines[line, s, 0] = upper + down * (lower - upper)
        describe(lines, per_width[k : k + 1], found, unused)
        out[k] = found[:, 0]
