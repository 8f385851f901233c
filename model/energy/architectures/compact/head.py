"""The compact network's head over a tile of a lattice, compiled: `CompactNet.ask` for all cells and headings.

Scratch arrays are flat, (anything, LANES), and inner loops run over at most LANES cells at constant offsets. The
compiler makes vector instructions of such loops only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.tracks import (
    LANES,
    SAMPLES,
    SQUARE,
    TRACKS,
    WIDEST_M,
    corner,
    describe,
    track_stencil,
)
from joulemap.model.energy.architectures.compact.weights import HEAD_BLOCK, SPREAD_RANGE
from joulemap.model.energy.grade import antipodes
from joulemap.model.energy.uncertainty import LEAST_SHARE

_MIDDLE = (SQUARE - 1) // 2
_FEATURES = len(TRACKS)
_LOWEST, _HIGHEST = (np.float32(limit) for limit in SPREAD_RANGE)
_INVERSE = tuple(np.float32(1.0 / max(n, 1)) for n in range(10))


@dataclass(frozen=True)
class Headings:
    """The headings of a lattice and where their tracks lie."""

    basis: NDArray[np.float32]  # (terms, K): The series' functions at the headings
    stencil: NDArray[np.float64]  # (2, samples, K, 2): As from `track_stencil`
    # (K,): The later heading that drives a heading's tracks the other way; -1 where there is none
    back: NDArray[np.int64]
    own: NDArray[np.bool_]  # (K,): Whether a heading is computed itself, and not as the opposite of an earlier one
    per_width: float  # One over the distance of the tracks [1/m]

    @classmethod
    def of(cls, headings_rad: NDArray[np.float64], basis: NDArray[np.float32], width_m: float) -> Headings:
        """Prepare the headings of a lattice.

        `headings_rad` (K,); `basis` (K, terms): the series' functions at these headings.
        """
        ahead, sign = antipodes(headings_rad)
        own = sign > 0.0
        back = np.full(headings_rad.size, -1)
        back[ahead[~own]] = np.flatnonzero(~own)
        stencil = track_stencil(headings_rad, np.full(headings_rad.size, width_m))
        return cls(np.ascontiguousarray(basis.T), stencil, back, own, 1.0 / min(width_m, WIDEST_M))


@njit(cache=True, nogil=True)
def answer_tile(ground, series, basis, stencil, back, own, per_width, weights, known, price, at, traction, std):
    """Fill a tile of a lattice with traction and uncertainty.

    The whole lattice is passed: a part of it would be contiguous in some calls and not in others, and the function
    would be compiled twice.

    `ground`: heights [m] as from `raster.read_cells`; `series` (units * terms, rows * cols): as from
    `ground.read_ground`; `known` (3,): a mu, c and the weight [N]; `price` (4,): the robot's hotel_per_m [J/m] and
    regeneration, the energy of level ground [J], and the factor of the spread; `traction` (_, _, K): of the whole
    lattice [J/m], holds the grade before the call; `std` (_, _, K): of the whole lattice: standard deviation of a
    segment's energy [J].
    """
    top, left, step, rows, cols = at
    count, terms = traction.shape[2], series.shape[0]
    units, last = weights[0].shape[0], weights[2].shape[0]
    lines = np.zeros(2 * SAMPLES * LANES, dtype=np.float32)
    widths = np.full(LANES, np.float32(per_width))
    met, fall = np.zeros(_FEATURES * LANES, dtype=np.float32), np.zeros(LANES, dtype=np.float32)
    coefficients = np.zeros(terms * LANES, dtype=np.float32)
    ahead, behind = np.zeros(units * LANES, dtype=np.float32), np.zeros(units * LANES, dtype=np.float32)
    second, out = np.zeros(last * LANES, dtype=np.float32), np.zeros(2 * LANES, dtype=np.float32)
    demand, spread = np.zeros(count * LANES, dtype=np.float32), np.zeros(count * LANES, dtype=np.float32)
    for i in range(rows):
        for j in range(0, cols, LANES):
            lanes = min(LANES, cols - j)
            for c in range(terms):
                for b in range(lanes):
                    coefficients[c * LANES + b] = series[c, i * cols + j + b]
            for b in range(lanes):
                for k in range(count):
                    demand[k * LANES + b] = traction[top + step * i, left + step * (j + b), k]
            for k in range(count):
                if own[k]:
                    _sample(ground, i, j, lanes, stencil, k, lines)
                    describe(lines, lanes, widths, met, fall)
                    _unchanged(coefficients, basis, k, lanes, met, weights[0], weights[1], ahead)
                    behind[:] = 0.0
                    _harmonics(coefficients, basis, k, lanes, 1, behind)
                    _harmonics(coefficients, basis, k, lanes, 2, ahead)
                    _either_way(lanes, met, fall, weights[0], ahead, behind)
                    _rest(lanes, ahead, weights, second, out)
                    _price(lanes, out, known, price, k * LANES, demand, spread)
                    if back[k] >= 0:
                        _rest(lanes, behind, weights, second, out)
                        _price(lanes, out, known, price, back[k] * LANES, demand, spread)
            for b in range(lanes):
                unknown = np.isnan(coefficients[b])
                for k in range(count):
                    r, c = top + step * i, left + step * (j + b)
                    traction[r, c, k] = np.nan if unknown else demand[k * LANES + b]
                    std[r, c, k] = np.nan if unknown else spread[k * LANES + b]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _sample(ground, i, j, lanes, stencil, k, lines):
    """Heights [m] above their middle of the tracks of LANES cells from (i, j) on, driven in heading k."""
    planes = ground.shape[1]
    row = planes * i + _MIDDLE
    middle = ground[row, _MIDDLE % planes, j + _MIDDLE // planes :]
    for line in range(2):
        for s in range(SAMPLES):
            down, south = corner(stencil[line, s, k, 0])
            right, east = corner(stencil[line, s, k, 1])
            r, west = row + down, _MIDDLE + right
            p0, s0, p1, s1 = west % planes, j + west // planes, (west + 1) % planes, j + (west + 1) // planes
            nw, ne, sw, se = ground[r, p0, s0:], ground[r, p1, s1:], ground[r + 1, p0, s0:], ground[r + 1, p1, s1:]
            at = (line * SAMPLES + s) * LANES
            for b in range(min(lanes, LANES)):
                upper, lower = nw[b] + east * (ne[b] - nw[b]), sw[b] + east * (se[b] - sw[b])
                lines[at + b] = upper + south * (lower - upper) - middle[b]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _unchanged(coefficients, basis, k, lanes, met, tracks_w, shift, out):
    """The part of the head's first layer, (units, LANES), that heading k and its opposite share: the series' mean and
    those features of the tracks that do not depend on the direction.
    """
    for u in range(tracks_w.shape[0]):
        mean, row = coefficients[u * basis.shape[0] * LANES :], out[u * LANES :]
        for b in range(min(lanes, LANES)):
            total = shift[u] + basis[0, k] * mean[b] + tracks_w[u, 1] * met[LANES + b]
            for f in range(3, _FEATURES):
                total += tracks_w[u, f] * met[f * LANES + b]
            row[b] = total


@njit(cache=True, nogil=True, fastmath={"contract"})
def _harmonics(coefficients, basis, k, lanes, first, out):
    """Add every second harmonic to `out` (units, LANES), from the `first` on."""
    terms = basis.shape[0]
    for u in range(out.size // LANES):
        for n in range((terms // 2 - first + 2) // 2):
            c = 4 * n + 2 * first - 1
            sine, cosine = basis[c, k], basis[c + 1, k]
            both, row = coefficients[(u * terms + c) * LANES :], out[u * LANES :]
            for b in range(min(lanes, LANES)):
                row[b] += sine * both[b] + cosine * both[LANES + b]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _either_way(lanes, met, fall, tracks_w, ahead, back):
    """From the part that both headings share (`ahead`) and the part that changes its sign (`back`) to the first layer's
    answer for both: the grade changes its sign, the rise becomes the fall.
    """
    zero = np.float32(0.0)
    for u in range(tracks_w.shape[0]):
        grade, rise, one, other = tracks_w[u, 0], tracks_w[u, 2], ahead[u * LANES :], back[u * LANES :]
        for b in range(min(lanes, LANES)):
            same, turned = one[b], other[b] + grade * met[b]
            one[b] = max(same + turned + rise * met[2 * LANES + b], zero)
            other[b] = max(same - turned + rise * fall[b], zero)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _layer(weight, bias, lanes, below, above):
    """weight @ below + bias, (n, LANES) from (blocks of HEAD_BLOCK, LANES)."""
    for v in range(weight.shape[0]):
        row = above[v * LANES :]
        for b in range(min(lanes, LANES)):
            row[b] = bias[v]
        for block in range(weight.shape[1] // HEAD_BLOCK):
            of, part = weight[v, block * HEAD_BLOCK :], below[block * HEAD_BLOCK * LANES :]
            for b in range(min(lanes, LANES)):
                total = row[b]
                for n in range(HEAD_BLOCK):
                    total += of[n] * part[n * LANES + b]
                row[b] = total


@njit(cache=True, nogil=True, fastmath={"contract"})
def _rest(lanes, first, weights, second, out):
    """The head's other layers: (units, LANES) -> (2, LANES), the rest over the weight and the spread's logarithm."""
    _layer(weights[2], weights[3], lanes, first, second)
    for n in range(second.size):
        second[n] = max(second[n], np.float32(0.0))
    _layer(weights[4], weights[5], lanes, second, out)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _price(lanes, out, known, price, at, demand, spread):
    """Traction [J/m] and standard deviation [J] of LANES cells at one heading; `demand` holds their grade before."""
    resistance, climb, weight_n = known
    hotel, regeneration, level, factor = price
    zero, one, least = np.float32(0.0), np.float32(1.0), np.float32(LEAST_SHARE * level)
    grade, deviation = demand[at:], spread[at:]
    for b in range(min(lanes, LANES)):
        wanted = weight_n * (resistance + climb * grade[b] + out[b])
        energy = hotel + max(wanted, zero) + regeneration * min(wanted, zero)
        eighth = np.float32(0.125) * min(max(out[LANES + b], _LOWEST), _HIGHEST)
        relative = one  # exp(8 x) = exp(x)^8, and Taylor's tenth power of less than 0.6 is nothing
        for n in range(9, 0, -1):
            relative = one + relative * eighth * _INVERSE[n]
        for _ in range(3):
            relative *= relative
        grade[b] = wanted
        deviation[b] = factor * relative * max(energy, least)
