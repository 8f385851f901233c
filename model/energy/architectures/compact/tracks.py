"""The ground under the two wheel tracks of a 1 m segment: nine numbers per place and heading, from the heightmap.

A network that reads the ground around a place as a whole spreads a bump over tens of degrees of heading; wheels meet it
in a narrow range. These numbers are sharp in heading, cheap (two lines of `SAMPLES` heights), and the same for a single
segment and for a whole lattice. Driving the other way swaps and reverses the lines, which changes only the grade and
the rise.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_vector

PIXEL_M = 0.125
"""Side of a working pixel [m]: eight to the metre."""
SQUARE = 17
"""Heights along a side of the square that one answer sees: 16 pixels, 2 m."""
REACH_M = (SQUARE - 1) // 2 * PIXEL_M
"""How far around a place the network looks [m], along both axes."""
SAMPLES = 13
"""Heights along a track: from 0.75 m behind the middle of the segment to as far ahead."""
WIDEST_M = 1.3
"""Greatest distance of the tracks [m]: those of wider robots would leave the square."""

TRACKS = (
    "grade",
    "cross_grade",
    "rise",
    "second_difference_125",
    "second_difference_250",
    "second_difference_375",
    "curvature",
    "roughness",
    "twist",
)
"""grade : least-squares slope of both tracks [1]. cross_grade : |right - left| over the width [1]. rise : sum of all
steps up [m]. second_difference_mmm : sum of |second differences| over that many millimetres [m]. curvature : ends minus
the middle [m], mean of both tracks. roughness : root mean square about each track's own line [m]. twist : difference of
the climbs of the two tracks [m]. Each is divided by its entry of `TRACK_SCALES`."""
TRACK_SCALES = np.array([0.1, 0.1, 0.2, 0.2, 0.4, 0.5, 0.05, 0.02, 0.05], dtype=np.float32)
"""What brings each of `TRACKS` to about one on rough ground."""
_PER_SCALE = tuple(np.float32(1.0 / scale) for scale in TRACK_SCALES)

LANES = 64
"""Places that the compiled loops describe at a time, a constant so that loops become vector instructions."""

_MIDDLE = (SAMPLES - 1) // 2


def track_stencil(heading_rad: NDArray[np.float64], width_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the samples of the tracks lie.

    `heading_rad` (n,); `width_m` (n,): widths of the robots [m]. Result: (south, east) in working pixels from the
    middle of the square; the left track first.
    """
    ahead_x, ahead_y = heading_vector(heading_rad)
    along = np.arange(SAMPLES)[:, None] - _MIDDLE
    sideways = 0.5 * np.minimum(width_m, WIDEST_M) / PIXEL_M
    out = np.empty((2, SAMPLES, heading_rad.size, 2))
    for line, right in ((0, -sideways), (1, sideways)):
        out[line, :, :, 0] = -along * ahead_y + right * ahead_x
        out[line, :, :, 1] = along * ahead_x + right * ahead_y
    return out


def track_features(
    squares: NDArray[np.float32], heading_rad: NDArray[np.float64], width_m: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the features of the wheel tracks of segments.

    `squares` (n, 17, 17): heights around the segments [m], north up; `heading_rad` (n,); `width_m` (n,): widths of the
    robots [m]. The result is (n, 9).
    """
    out = np.empty((heading_rad.size, len(TRACKS)), dtype=np.float32)
    per_width = (1.0 / np.minimum(width_m, WIDEST_M)).astype(np.float32)
    _of_squares(squares, track_stencil(heading_rad, width_m), per_width, out)
    return out


@njit(cache=True, nogil=True, fastmath={"contract"})
def _line(z, lanes, found):
    """Mean, slope, squares about the line, steps up, steps down and the three sums of second differences of one track,
    (8, LANES), from its samples z (SAMPLES, LANES). Offsets are constants and nothing branches, so that it becomes
    vector code.
    """
    squares = np.float32(_MIDDLE * (_MIDDLE + 1) * SAMPLES / 3.0)  # sum of (s - middle)^2
    two, half = np.float32(2.0), np.float32(0.5)
    for b in range(min(lanes, LANES)):
        mean = slope = about = steps = second_1 = second_2 = second_3 = np.float32(0.0)
        for s in range(SAMPLES):
            mean += z[s * LANES + b]
            slope += np.float32(s - _MIDDLE) * z[s * LANES + b]
        mean /= np.float32(SAMPLES)
        slope /= squares
        for s in range(SAMPLES):
            off = z[s * LANES + b] - mean - np.float32(s - _MIDDLE) * slope
            about += off * off
        for s in range(SAMPLES - 1):
            steps += abs(z[(s + 1) * LANES + b] - z[s * LANES + b])
        for s in range(1, SAMPLES - 1):
            pair = z[(s - 1) * LANES + b] + z[(s + 1) * LANES + b]
            second_1 += abs(pair - two * z[s * LANES + b])
        for s in range(2, SAMPLES - 2):
            pair = z[(s - 2) * LANES + b] + z[(s + 2) * LANES + b]
            second_2 += abs(pair - two * z[s * LANES + b])
        for s in range(3, SAMPLES - 3):
            pair = z[(s - 3) * LANES + b] + z[(s + 3) * LANES + b]
            second_3 += abs(pair - two * z[s * LANES + b])
        climb = z[(SAMPLES - 1) * LANES + b] - z[b]
        found[b], found[LANES + b], found[2 * LANES + b] = mean, slope, about
        found[3 * LANES + b], found[4 * LANES + b] = half * (steps + climb), half * (steps - climb)
        found[5 * LANES + b], found[6 * LANES + b], found[7 * LANES + b] = second_1, second_2, second_3


@njit(cache=True, nogil=True, fastmath={"contract"})
def _both(lines, lanes, left, right, per_width, met, fall):
    """The features of two tracks, each as from `_line`."""
    half, per_pixel, per_sample = np.float32(0.5), np.float32(0.5 / PIXEL_M), np.float32(0.5 / SAMPLES)
    end, middle, other = (SAMPLES - 1) * LANES, _MIDDLE * LANES, SAMPLES * LANES
    for b in range(min(lanes, LANES)):
        left_0, left_1, right_0, right_1 = lines[b], lines[end + b], lines[other + b], lines[other + end + b]
        middles = lines[middle + b] + lines[other + middle + b]
        met[b] = _PER_SCALE[0] * per_pixel * (left[LANES + b] + right[LANES + b])
        met[LANES + b] = _PER_SCALE[1] * abs(right[b] - left[b]) * per_width[b]
        met[2 * LANES + b] = _PER_SCALE[2] * (left[3 * LANES + b] + right[3 * LANES + b])
        met[3 * LANES + b] = _PER_SCALE[3] * (left[5 * LANES + b] + right[5 * LANES + b])
        met[4 * LANES + b] = _PER_SCALE[4] * (left[6 * LANES + b] + right[6 * LANES + b])
        met[5 * LANES + b] = _PER_SCALE[5] * (left[7 * LANES + b] + right[7 * LANES + b])
        met[6 * LANES + b] = _PER_SCALE[6] * (half * (left_0 + left_1 + right_0 + right_1) - middles)
        met[7 * LANES + b] = _PER_SCALE[7] * np.sqrt(per_sample * (left[2 * LANES + b] + right[2 * LANES + b]))
        met[8 * LANES + b] = _PER_SCALE[8] * abs((right_1 - right_0) - (left_1 - left_0))
        fall[b] = _PER_SCALE[2] * (left[4 * LANES + b] + right[4 * LANES + b])


@njit(cache=True, nogil=True, fastmath={"contract"})
def describe(lines, lanes, per_width, met, fall):
    """Compute the features of the tracks of LANES places. All arrays are flat.

    Driven the other way, the grade changes its sign and the rise becomes `fall`; nothing else changes.

    `lines`: heights along the tracks [m].
    """
    left, right = np.empty(8 * LANES, dtype=np.float32), np.empty(8 * LANES, dtype=np.float32)
    _line(lines, lanes, left)
    _line(lines[SAMPLES * LANES :], lanes, right)
    _both(lines, lanes, left, right, per_width, met, fall)


@njit(cache=True, nogil=True)
def corner(offset):
    """Split a fractional offset. Returns `whole`: the pixel below; `part`: the rest, 0 to 1."""
    whole = math.floor(offset)
    return whole, offset - whole


@njit(cache=True, nogil=True)
def _of_squares(squares, stencil, per_width, out):
    middle = (SQUARE - 1) // 2
    lines = np.zeros(2 * SAMPLES * LANES, dtype=np.float32)
    widths = np.zeros(LANES, dtype=np.float32)
    met, fall = np.empty(out.shape[1] * LANES, dtype=np.float32), np.empty(LANES, dtype=np.float32)
    for start in range(0, squares.shape[0], LANES):
        lanes = min(LANES, squares.shape[0] - start)
        for b in range(lanes):
            k = start + b
            widths[b] = per_width[k]
            for line in range(2):
                for s in range(SAMPLES):
                    row, down = corner(stencil[line, s, k, 0])
                    col, right = corner(stencil[line, s, k, 1])
                    i, j = middle + row, middle + col
                    upper = squares[k, i, j] + right * (squares[k, i, j + 1] - squares[k, i, j])
                    lower = squares[k, i + 1, j] + right * (squares[k, i + 1, j + 1] - squares[k, i + 1, j])
                    lines[(line * SAMPLES + s) * LANES + b] = upper + down * (lower - upper)
        describe(lines, lanes, widths, met, fall)
        for b in range(lanes):
            for f in range(out.shape[1]):
                out[start + b, f] = met[f * LANES + b]
