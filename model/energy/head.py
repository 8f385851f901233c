"""The compact network's head over a tile of a lattice, compiled: `CompactNet.ask` for all cells and headings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from model.energy.compact import SPREAD_RANGE, STRIDE
from model.energy.physics import antipodes
from model.energy.tracks import SQUARE, WIDEST_M, corner, describe, track_stencil
from model.energy.uncertainty import LEAST_SHARE

_MIDDLE = (SQUARE - 1) // 2
_LOWEST, _HIGHEST = (np.float32(limit) for limit in SPREAD_RANGE)


@dataclass(frozen=True)
class Headings:
    """The headings of a lattice and where their tracks lie. headings_rad : (K,). basis : (C, K) float32. stencil :
    (2, samples, K, 2). own, sign : the earlier heading whose tracks, driven back, are those of a heading, and -1; else
    itself, and 1. per_width : one over the distance of the tracks [1/m]."""

    basis: NDArray[np.float32]
    stencil: NDArray[np.float64]
    own: NDArray[np.int64]
    sign: NDArray[np.float64]
    per_width: float

    @classmethod
    def of(cls, headings_rad: NDArray[np.float64], basis: NDArray[np.float32], width_m: float) -> Headings:
        """basis : (K, C), the series' functions at those headings."""
        own, sign = antipodes(headings_rad)
        stencil = track_stencil(headings_rad, np.full(headings_rad.size, width_m))
        return cls(np.ascontiguousarray(basis.T), stencil, own, sign, 1.0 / min(width_m, WIDEST_M))


@njit(cache=True, nogil=True)
def answer_tile(heights, series, basis, stencil, own, sign, per_width, weights, known, price, at, traction, std):
    """Fill a tile: traction [J/m] (holding the grade before) and the standard deviation of a segment's energy [J].

    Its cells are every `step`-th of the lattice from (top, left) on, at = (top, left, step): the whole lattice is
    handed over, because a part of it is contiguous or not by chance, and the loop would be compiled for both.
    heights : (8 rows + 9, 8 cols + 9) [m], the working pixels around the cells. series : (rows, cols, units * C).
    basis, stencil, own, sign, per_width : as in `Headings`. weights : as from `CompactNet.folded_head`. known : a mu, c
    and the weight [N]. price : the robot's hotel_per_m and regeneration, the energy of level ground [J], and the factor
    of the spread (as `segment_std`). traction, std : of the lattice, (_, _, K) float32.
    """
    tracks_w, shift, head_w, head_b, final_w, final_b = weights
    resistance, climb, weight_n = known
    hotel, regeneration, level, factor = price
    top, left, step = at
    rows, cols = series.shape[:2]
    count = traction.shape[2]
    units, features = tracks_w.shape
    last, terms = head_w.shape[0], basis.shape[0]
    zero = np.float32(0.0)
    lines = np.empty((2, stencil.shape[1], cols), dtype=np.float32)
    ahead, back = np.empty((features, cols), dtype=np.float32), np.empty((features, cols), dtype=np.float32)
    kept = np.empty((count, features, cols), dtype=np.float32)
    widths = np.full(cols, np.float32(per_width), dtype=np.float32)
    coefficients = np.empty((units * terms, cols), dtype=np.float32)
    first, second = np.empty((units, cols), dtype=np.float32), np.empty((last, cols), dtype=np.float32)
    out = np.empty((2, cols), dtype=np.float32)
    for i in range(rows):
        for j in range(cols):
            for c in range(units * terms):
                coefficients[c, j] = series[i, j, c]
        for k in range(count):
            if sign[k] > 0.0:
                for line in range(2):
                    for s in range(lines.shape[1]):
                        down, south = corner(stencil[line, s, k, 0])
                        right, east = corner(stencil[line, s, k, 1])
                        r, c = STRIDE * i + _MIDDLE + down, _MIDDLE + right
                        for j in range(cols):
                            middle = heights[STRIDE * i + _MIDDLE, STRIDE * j + _MIDDLE]
                            nw, ne = heights[r, c + STRIDE * j], heights[r, c + STRIDE * j + 1]
                            sw, se = heights[r + 1, c + STRIDE * j], heights[r + 1, c + STRIDE * j + 1]
                            upper, lower = nw + east * (ne - nw), sw + east * (se - sw)
                            lines[line, s, j] = upper + south * (lower - upper) - middle
                describe(lines, widths, ahead, back)
                kept[k] = back
                met = ahead
            else:
                met = kept[own[k]]
            for u in range(units):
                for j in range(cols):
                    first[u, j] = shift[u]
                for c in range(terms):
                    for j in range(cols):
                        first[u, j] += basis[c, k] * coefficients[u * terms + c, j]
                for f in range(features):
                    for j in range(cols):
                        first[u, j] += tracks_w[u, f] * met[f, j]
                for j in range(cols):
                    first[u, j] = max(first[u, j], zero)
            for v in range(last):
                for j in range(cols):
                    second[v, j] = head_b[v]
                for u in range(units):
                    for j in range(cols):
                        second[v, j] += head_w[v, u] * first[u, j]
                for j in range(cols):
                    second[v, j] = max(second[v, j], zero)
            for o in range(2):
                for j in range(cols):
                    out[o, j] = final_b[o]
                for v in range(last):
                    for j in range(cols):
                        out[o, j] += final_w[o, v] * second[v, j]
            for j in range(cols):
                r, c = top + step * i, left + step * j
                if np.isnan(series[i, j, 0]):
                    traction[r, c, k] = np.nan
                    std[r, c, k] = np.nan
                else:
                    demand = weight_n * (resistance + climb * traction[r, c, k] + out[0, j])
                    energy = hotel + max(demand, 0.0) + regeneration * min(demand, 0.0)
                    relative = math.exp(min(max(out[1, j], _LOWEST), _HIGHEST))
                    traction[r, c, k] = demand
                    std[r, c, k] = factor * relative * max(energy, LEAST_SHARE * level)
