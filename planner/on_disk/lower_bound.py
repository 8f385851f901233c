"""A proven lower bound of the energy from every cell to a goal, from the coarse level alone.

The bound is h = phi - s * surface + constant, with phi linear on the two triangles of every block of cells. On a block
B with the least energies m_k(B) beyond the rise (`coarse`), a move in direction u_k cannot cost less than h falls along
it where

    - grad(phi) . u_k  <=  m_k(B)      on both triangles of B, for every direction k.

A move that crosses several blocks has, on its part in each, at least that block's m_k, so h falls by no more than the
move costs: h is consistent, and lies below the energy of every path (see `heuristics` for the potential s * surface).
The first guess of phi is a Dijkstra search over the corners of the blocks. It breaks some of the inequalities, all of
which are linear: projections onto the half-spaces (Gauss-Seidel) repair it, and what is left is scaled away. So the
bound is proven by the inequalities, however phi was found.

References
----------
Johnson 1977 (potentials); Agmon 1954, Motzkin & Schoenberg 1954 (projections for linear inequalities).
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.on_disk.coarse import CoarseLevel

SWEEPS = 120
"""Most rounds of projections; a round only visits blocks near a broken inequality."""
_SPARE = 0.002
"""How far within the inequalities the projections aim, as a share of the median: they approach their aim slowly."""
_SCALE_LEFT = 0.2
"""A share of the rise is left out where more than this would have to be scaled away."""
_CAP = 3.0
"""What a block without moves costs in the first guess, in medians; no inequality holds there."""


def potentials_towards(
    coarse: CoarseLevel, goal: NDArray[np.float64], unit: NDArray[np.float64], spacing_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower bounds towards a goal, without their constants.

    `coarse`: of the lattice; `goal` (2,): fractional (row, col); `unit` (N, 2): (row, col) step of each direction, of
    length 1; `spacing_m`: side of a cell [m]. Returns `shares` (P,): shares s of the surface: of the rise, for which
    there is a bound; `nodes_j` (P, block rows + 1, block cols + 1): phi of each at the corners of the blocks [J].
    """
    shares, found = [], []
    side = coarse.block_cells * spacing_m
    for share, least in zip(coarse.shares.tolist(), coarse.least_per_m, strict=True):
        finite = np.isfinite(least)
        if not finite.any():
            return np.zeros(1), np.zeros((1, least.shape[0] + 1, least.shape[1] + 1))
        typical = float(np.median(least[finite]))
        nodes = np.zeros((least.shape[0] + 1, least.shape[1] + 1))
        if typical > 0.0:
            guess = np.where(finite, np.maximum(least, 0.0), _CAP * typical)
            nodes = _first_guess(guess, goal, unit, side, coarse.block_cells)
            _project(nodes, least - np.float32(_SPARE * typical), unit, side, SWEEPS)
            over, broken = _worst(nodes, least, unit, side)
            if broken or over > _SCALE_LEFT:
                nodes[:] = 0.0
            nodes /= 1.0 + over
        if nodes.any() or least.min() >= 0.0:  # the least bound of all is that nothing is cheaper than the rise
            shares.append(share)
            found.append(nodes)
    return np.array(shares), np.stack(found)


def _first_guess(
    least: NDArray[np.float64], goal: NDArray[np.float64], unit: NDArray[np.float64], side_m: float, block: int
) -> NDArray[np.float64]:
    """(rows + 1, cols + 1) [J]: energies to the goal over the corners of blocks, each at the least of its blocks."""
    rows, cols, moves = least.shape
    corner = np.full((rows + 1, cols + 1, moves), np.inf)
    for a in (0, 1):
        for b in (0, 1):
            here = corner[a : a + rows, b : b + cols]
            np.minimum(here, least, out=here)
    offsets = np.rint(unit / np.abs(unit).max(axis=1, keepdims=True) * 6.0).astype(np.int64)
    offsets //= np.gcd(offsets[:, :1], offsets[:, 1:])
    price = np.full(corner.shape, np.nan, dtype=np.float32)
    for n, (down, right) in enumerate(offsets.tolist()):
        length = np.hypot(down, right) * side_m
        i, j = _shifted(down, rows + 1), _shifted(right, cols + 1)
        price[i[0], j[0], n] = 0.5 * (corner[i[0], j[0], n] + corner[i[1], j[1], n]) * length
    near = np.clip(np.rint(goal / block).astype(np.int64), 0, [rows, cols])
    return _to_goal(price, offsets, near[0], near[1])


@njit(cache=True, nogil=True)
def _to_goal(price, offsets, row, col):
    """(rows, cols) [J]: least energies to one corner, by Dijkstra's search."""
    rows, cols, moves = price.shape
    energy = np.full((rows, cols), np.inf)
    energy[row, col] = 0.0
    queue = [(0.0, row, col)]
    while len(queue) > 0:
        so_far, i, j = heappop(queue)
        if so_far > energy[i, j]:
            continue
        for n in range(moves):
            r, c = i - offsets[n, 0], j - offsets[n, 1]
            if 0 <= r < rows and 0 <= c < cols and so_far + price[r, c, n] < energy[r, c]:
                energy[r, c] = so_far + price[r, c, n]
                heappush(queue, (energy[r, c], r, c))
    return energy


def _shifted(step: int, size: int) -> tuple[slice, slice]:
    """From where and to where a step leads within an axis."""
    step = min(max(step, -size), size)
    return slice(max(0, -step), min(size, size - step)), slice(max(0, step), min(size, size + step))


@njit(cache=True, nogil=True)
def _project(nodes, least, unit, side, sweeps):
    """Move `nodes` until - grad . u_k <= least_k on both triangles of every block, or the sweeps are over."""
    rows, cols, moves = least.shape
    active = np.ones((rows, cols), dtype=np.bool_)
    for _ in range(sweeps):
        after = np.zeros((rows, cols), dtype=np.bool_)
        some = False
        for i in range(rows):
            for j in range(cols):
                if not active[i, j]:
                    continue
                moved = False
                for corner in range(2):  # the triangle around the north-west corner, or the south-east one
                    for k in range(moves):
                        u, v = unit[k, 0], unit[k, 1]
                        if corner == 0:
                            over = (nodes[i, j] - nodes[i + 1, j]) * u + (nodes[i, j] - nodes[i, j + 1]) * v
                        else:
                            over = (nodes[i, j + 1] - nodes[i + 1, j + 1]) * u
                            over += (nodes[i + 1, j] - nodes[i + 1, j + 1]) * v
                        over -= least[i, j, k] * side
                        if over <= 0.0:
                            continue
                        step = over / (1.0 + (u + v) * (u + v))
                        if corner == 0:
                            nodes[i, j] -= (u + v) * step
                            nodes[i + 1, j] += u * step
                            nodes[i, j + 1] += v * step
                        else:
                            nodes[i + 1, j + 1] += (u + v) * step
                            nodes[i, j + 1] -= u * step
                            nodes[i + 1, j] -= v * step
                        moved = True
                if moved:
                    some = True
                    after[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
        if not some:
            return
        active = after


@njit(cache=True, nogil=True)
def _worst(nodes, least, unit, side):
    """Largest share by which an inequality is broken, and whether one is broken that scaling cannot restore."""
    rows, cols, moves = least.shape
    worst = 0.0
    for i in range(rows):
        for j in range(cols):
            for k in range(moves):
                u, v = unit[k, 0] / side, unit[k, 1] / side
                a = (nodes[i, j] - nodes[i + 1, j]) * u + (nodes[i, j] - nodes[i, j + 1]) * v
                b = (nodes[i, j + 1] - nodes[i + 1, j + 1]) * u + (nodes[i + 1, j] - nodes[i + 1, j + 1]) * v
                fall = max(a, b)
                if fall > least[i, j, k]:
                    if least[i, j, k] <= 0.0:
                        return worst, True
                    worst = max(worst, fall / least[i, j, k] - 1.0)
                elif not fall <= least[i, j, k]:
                    return worst, True  # not a number
    return worst, False


@njit(cache=True, nogil=True)
def fill_bounds(out, surface, row, col, nodes, shares, constants, block):
    """Fill the lower bounds of the cells of one tile.

    `out` (height, width): is filled [J]; `surface` (height, width): the surface of these cells [J]; `row`, `col`: the
    tile's north-west cell; `nodes` (S, block rows + 1, block cols + 1): phi of each potential [J]; `shares`,
    `constants` (S,): their shares of the surface, and their constants [J]; `block`: cells along a block.
    """
    for i in range(out.shape[0]):
        a = (row + i) // block
        y = (row + i) / block - a
        for j in range(out.shape[1]):
            b = (col + j) // block
            x = (col + j) / block - b
            best = -np.inf
            for s in range(shares.size):
                if x + y <= 1.0:
                    corner = nodes[s, a, b]
                    phi = corner + y * (nodes[s, a + 1, b] - corner) + x * (nodes[s, a, b + 1] - corner)
                else:
                    corner = nodes[s, a + 1, b + 1]
                    phi = corner + (1 - y) * (nodes[s, a, b + 1] - corner) + (1 - x) * (nodes[s, a + 1, b] - corner)
                best = max(best, phi - shares[s] * surface[i, j] + constants[s])
            out[i, j] = best
