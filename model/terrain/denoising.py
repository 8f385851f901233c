"""The ground as a noisy survey lets it be known: the heights without its noise.

Heights are split into details of 2, 4 and 8 cells, and of 16 where noise is alike over some of them, and the rest (B3
splines with holes, Starck & Murtagh 2006).
Noise has known shares in them, which follow from its correlation: 0.89, 0.20 and 0.09 of its standard deviation where
it is independent from cell to cell.
Where the details nearby are larger than noise makes them, they are kept (local Wiener filter, Mihcak et al. 1999;
twice, the second time with the result of the first for the ground, as Lebrun 2012). What this takes away of long steps
is given back (`step_edges`).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.ranges import NOISE_LENGTH_M, NOISE_M
from joulemap.model.terrain.step_edges import REACH_CELLS, given_back
from joulemap.model.threads import pieces, share_out

FloatArray = NDArray[np.float32]

NOISE_SHARES = (0.8908, 0.2007, 0.0857)
"""Standard deviation of the details of white noise of unit standard deviation, per scale (Starck & Murtagh 2006)."""
_SCALES = len(NOISE_SHARES)
_SPLINE = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
LEAST_NOISE_M = 0.003
"""Noise below this changes no price by 1 %, and rough ground alone may look like it."""
_HALF_SIDE = 3
"""The ground is taken to be alike within 7 x 7 cells."""
_WIDE_CELLS = 1.5
"""Noise that is alike over more is partly in details of 16 cells."""
_GRAIN_M = np.float32(2.0**-12)
"""Far below the least noise."""
_ROWS_AT_ONCE = 64


def check_noise(noise_m: float | None, length_m: float) -> None:
    """Check a standard deviation and a correlation length that somebody gives [m]; raises HeightmapError."""
    if noise_m is not None and noise_m not in NOISE_M:
        raise HeightmapError(
            f"`noise_m`, the noise of a survey, must lie in 0..{NOISE_M.high:g} m, got {noise_m:g}",
            noise_m=str(noise_m),
            limit=NOISE_M.high,
        )
    if length_m not in NOISE_LENGTH_M:
        raise HeightmapError(
            f"`noise_length_m`, over which noise is alike, must lie in 0..{NOISE_LENGTH_M.high:g} m, got {length_m:g}",
            noise_length_m=str(length_m),
            limit=NOISE_LENGTH_M.high,
        )
    if length_m > 0.0 and noise_m is None:
        raise HeightmapError(
            f"`noise_length_m` is {length_m:g} m, and `noise_m` is missing: a length alone is no noise, give its "
            "standard deviation too",
            noise_length_m=str(length_m),
        )


def correlation_of(cells: FloatArray, length_cells: float) -> FloatArray:
    """Return the correlation of noise at distances (n,) [cells]: exp(-d^2 / 2 l^2), 0 for independent noise."""
    return np.exp(-0.5 * np.square(cells / max(length_cells, 1e-3)))


def scales_of(length_cells: float) -> int:
    """Return how many scales of details hold noise: one more where details of 8 cells leave a tenth of it and more."""
    return _SCALES + (length_cells > _WIDE_CELLS)


def margin_cells(length_cells: float) -> int:
    """Return how far a height without noise depends on others [cells], by the length over which noise is alike."""
    return 2 * (2 * (2 ** scales_of(length_cells) - 1) + _HALF_SIDE) + REACH_CELLS


@cache
def noise_shares(length_cells: float) -> tuple[float, ...]:
    """Return the standard deviation of the details of noise of unit standard deviation, per scale.

    A detail is the difference of two averages over separable splines s_a and s_b, and the correlation R is separable
    too: its variance is (s_a R s_a)^2 - 2 (s_a R s_b)^2 + (s_b R s_b)^2. Of independent noise as published.
    """
    if length_cells == 0.0:
        return NOISE_SHARES
    splines = [np.ones(1)]
    scales = scales_of(length_cells)
    for scale in range(scales):
        step = np.zeros(4 * 2**scale + 1)
        step[:: 2**scale] = _SPLINE
        splines.append(np.convolve(splines[-1], step))
    size = splines[-1].size
    wide = np.array([np.pad(spline, (size - spline.size) // 2) for spline in splines])  # (scales + 1, size)
    apart = np.subtract.outer(np.arange(size), np.arange(size))
    common = np.square(wide @ correlation_of(apart, length_cells) @ wide.T)
    variances = [common[k, k] - 2.0 * common[k, k + 1] + common[k + 1, k + 1] for k in range(scales)]
    return tuple(math.sqrt(max(variance, 0.0)) for variance in variances)


def hiding_noise_m(noise_m: float, length_cells: float) -> float:
    """Return the independent noise [m] that hides as much of the finest details as one alike over some cells."""
    return noise_m * noise_shares(length_cells)[0] / noise_shares(0.0)[0]


def denoised(heights: FloatArray, noise_m: float, length_cells: float = 0.0) -> FloatArray:
    """Return the expected heights of the ground, given a survey (rows, cols) [m], its noise and how far it is alike.

    Steps and bumps that stand out of the noise stay as they are; what cannot be told from noise is gone. Unknown
    heights (NaN) stay unknown. Below `LEAST_NOISE_M` nothing is changed.
    """
    if noise_m < LEAST_NOISE_M:
        return heights
    variances = [np.float32((noise_m * share) ** 2) for share in noise_shares(length_cells)]
    filled, known, base = _filled(heights)
    details, rest = _details(filled, known, len(variances))
    first = rest.copy()
    for detail, variance in zip(details, variances, strict=True):
        _by_rows(_add_shrunk, detail, detail, variance, True, first)
    out = rest
    for detail, ground, variance in zip(details, _details(first, known, len(variances))[0], variances, strict=True):
        _by_rows(_add_shrunk, detail, ground, variance, False, out)
    correlation = correlation_of(np.arange(REACH_CELLS + 1, dtype=np.float32), length_cells)
    # in whole grains, whose sums are exact: what counts as a step is the same in every window
    grains = np.rint(heights / _GRAIN_M) - np.rint(base / _GRAIN_M)
    out += given_back(grains * _GRAIN_M, filled - out, noise_m, correlation)
    return np.where(known > 0.0, out + base, np.float32(np.nan))


def _filled(heights: FloatArray) -> tuple[FloatArray, FloatArray, np.float32]:
    """Heights less a base with 0 where unknown, 1 where known and 0 elsewhere, and the base."""
    known = ~np.isnan(heights)
    base = np.float32(np.mean(heights[known], dtype=np.float64)) if known.any() else np.float32(0.0)
    return np.where(known, heights - base, np.float32(0.0)), known.astype(np.float32), base


def _details(filled: FloatArray, known: FloatArray, scales: int) -> tuple[list[FloatArray], FloatArray]:
    """The details of every scale, and the smooth rest."""
    whole = bool(known.all())
    details = []
    for scale in range(scales):
        detail, smooth = np.empty_like(filled), np.empty_like(filled)
        _by_rows(_smooth, filled, 2**scale, detail, smooth)
        if not whole:
            weight = np.empty_like(filled)
            _by_rows(_smooth, known, 2**scale, np.empty_like(filled), weight)
            smooth = np.where(known > 0.0, smooth / np.maximum(weight, np.float32(1e-3)), np.float32(0.0))
            detail = filled - smooth
        details.append(detail)
        filled = smooth
    return details, filled


def _by_rows(work, *arguments) -> None:  # type: ignore[no-untyped-def]
    """Call compiled work on parts of the rows of its last argument, in threads."""
    rows = arguments[-1].shape[0]
    share_out(lambda part: work(*arguments, part.start, part.stop), pieces(rows, _ROWS_AT_ONCE))


@njit(cache=True)
def _mirrored(at, size):
    """An index within 0..size - 1 for one beyond it."""
    while at < 0 or at >= size:
        at = -at if at < 0 else 2 * (size - 1) - at
    return at


@njit(cache=True, nogil=True)
def _mirror_ends(line, more):
    """Fill `more` values at either end of a line with those that lie as far inside."""
    cols = line.size - 2 * more
    for j in range(more):
        line[j] = line[more + _mirrored(j - more, cols)]
        line[more + cols + j] = line[more + _mirrored(cols + j, cols)]


# Unsigned columns and no check of divisors: only so are the loops over a row compiled to vector instructions (five
# times as fast).
@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _smooth(values, step, detail, out, first, end):
    """Fill rows first..end - 1 with averages over a B3 spline of 5 x 5 cells `step` apart, and what these leave out."""
    rows, cols = values.shape
    outer, inner, middle = np.float32(1 / 16), np.float32(1 / 4), np.float32(3 / 8)
    line = np.empty(cols + 4 * step, dtype=np.float32)
    count, one = np.uint64(cols), np.uint64(step)
    two, three, four = one + one, one + one + one, one + one + one + one
    for i in range(first, end):
        a, b = values[_mirrored(i - 2 * step, rows)], values[_mirrored(i - step, rows)]
        d, e = values[_mirrored(i + step, rows)], values[_mirrored(i + 2 * step, rows)]
        c = values[i]
        for j in range(count):
            line[j + two] = outer * (a[j] + e[j]) + inner * (b[j] + d[j]) + middle * c[j]
        _mirror_ends(line, 2 * step)
        to, more = out[i], detail[i]
        for j in range(count):
            average = (
                outer * (line[j] + line[j + four]) + inner * (line[j + one] + line[j + three]) + middle * line[j + two]
            )
            to[j] = average
            more[j] = c[j] - average


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _add_shrunk(details, like, variance, noisy, out, first, end):
    """Add details to rows first..end - 1, each by the share of the variance around it that is the ground's.

    like : what tells that variance. noisy : whether it has the noise in it too.
    """
    rows, cols = details.shape
    half, count = np.uint64(_HALF_SIDE), np.uint64(cols)
    line = np.empty(cols + 2 * _HALF_SIDE, dtype=np.float32)
    per_cell, zero = np.float32(1.0 / (2 * _HALF_SIDE + 1) ** 2), np.float32(0.0)
    noise = max(variance, np.float32(1e-12))  # without noise at this scale, both variances may be 0
    in_it = noise if noisy else zero
    for i in range(first, end):
        line[:] = zero
        for k in range(-_HALF_SIDE, _HALF_SIDE + 1):
            of = like[_mirrored(i + k, rows)]
            for j in range(count):
                line[j + half] += of[j] * of[j]
        _mirror_ends(line, _HALF_SIDE)
        to, own = out[i], details[i]
        for j in range(count):
            total = zero
            for k in range(2 * half + np.uint64(1)):
                total += line[j + k]
            ground = max(total * per_cell - in_it, zero)
            to[j] += own[j] * (ground / (ground + noise))
