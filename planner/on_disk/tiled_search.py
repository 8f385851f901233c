"""A* over a lattice that stays on disk: tiles of moves are priced when the search reaches them, within a given memory.

The bounds of the energy to come are those of the coarse level (`lower_bound`), so a search that ends has proven how far
its path is from the best one over grid moves. Tiles that are likely to be next are read and priced on other threads.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, TooLargeError
from joulemap.planner.grid.search import direct_energy, joining_legs, no_route, without_repeats
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk import tile_kernels as kernels
from joulemap.planner.on_disk.coarse import CoarseLevel
from joulemap.planner.on_disk.lower_bound import Potential, fill_bounds, potentials_towards
from joulemap.planner.on_disk.strip import reserved
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.move_prices import MovePrices

TILE_CELLS = 128
"""Side of a tile of the search, a power of two; a fourth of a chunk on disk, so that little is priced in vain."""
DEFAULT_MEMORY = 1_500_000_000
"""Most memory of a search [bytes] unless the user says so: labels of 80 million cells fit into it beside the prices."""
_PRICES_SHARE = 0.3
"""Share of the memory for priced tiles; the rest is for the labels of cells. Of the default it holds the tiles along
the edge of a search over 10,000 x 10,000 cells: with two thirds of it every tile is priced twice."""
_LEAST_SLOTS = 24
_LABEL_BYTES = 13
_THIN, _THICK = 4.0, 16.0
"""How far above the least key of all cells a tile is settled, in typical prices: thin while there is memory for the
prices of further tiles, as the fewest cells are settled twice; then thick, as a tile that the search leaves and comes
back to is priced again."""
_STEPS = 1_000_000
_THREADS = 2
_NEXT, _MOST_AHEAD = 4, 16
_EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True, eq=False, repr=False)
class TiledPath:
    """The answer of a search over tiles.

    Attributes
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline from start to goal.
    energy_j : float
        Its energy as the search counted it [J], turns not included.
    bound_j : float
        No path over grid moves costs less [J].
    expanded : int
        Number of settled cells.
    tiles : int
        Number of tiles that were priced; one that was dropped and priced again counts twice.
    """

    points: Points
    energy_j: float
    bound_j: float
    expanded: int
    tiles: int


class TiledSearch:
    """One question to a stored lattice.

    Parameters
    ----------
    stored : StoredLattice
        The lattice.
    moves : MovePrices
        Its moves.
    coarse : CoarseLevel, optional
        Its coarse level; without it the search is for the shortest path.
    memory_bytes : int, optional
        Most memory for priced tiles and labels.
    tile_cells : int, optional
        Side of a tile of the search, a power of two above the longest move.
    progress : callable, optional
        Called with the share of the way that is done, 0..1; an exception that it raises ends the search.
    """

    def __init__(
        self,
        stored: StoredLattice,
        moves: MovePrices,
        coarse: CoarseLevel | None,
        *,
        memory_bytes: int = DEFAULT_MEMORY,
        tile_cells: int = TILE_CELLS,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._stored, self._moves, self._coarse = stored, moves, coarse
        self._progress = progress
        rows, cols = stored.frame.shape
        self._side = tile_cells
        self._shift = self._side.bit_length() - 1
        self._tile_cols = -(-cols // self._side)
        self._tiles = -(-rows // self._side) * self._tile_cols
        cells = self._tiles * self._side**2
        energy, ahead, pred = (reserved((cells,), np.dtype(of)) for of in (np.float64, np.float32, np.uint8))
        self._labels = energy, ahead, pred
        self._opened = np.zeros(self._tiles, dtype=np.bool_)
        self._slot_of = np.full(self._tiles, -1, dtype=np.int32)
        self._used = np.zeros(self._tiles, dtype=np.int64)
        self._least = np.full(self._tiles, math.inf)
        self._memory = memory_bytes
        self._slot_bytes = 4 * self._side**2 * len(moves.offsets)
        slots = min(self._tiles, max(int(_PRICES_SHARE * memory_bytes) // self._slot_bytes, _LEAST_SLOTS))
        self._prices = np.empty((slots, self._side**2, len(moves.offsets)), dtype=np.float32)
        self._free = list(range(slots))
        self._priced = 0
        self._bounded: dict[int, Future[NDArray[np.float32]]] = {}
        self._ahead: OrderedDict[int, Future[NDArray[np.float32]]] = OrderedDict()

    def run(self, start: Points, goal: Points) -> TiledPath:
        """Return the best path.

        Parameters
        ----------
        start, goal : ndarray of float, (2,)
            Fractional (row, col), joined to the cell centres around them by straight legs.

        Returns
        -------
        TiledPath
            The path with its proven bound.

        Raises
        ------
        NoRouteError
            If the goal cannot be reached.
        TooLargeError
            If the labels of the cells that the search reaches need more memory than is allowed.
        InputError
            If prices are so far below zero that the coarse level proves nothing.
        """
        begins, first = self._joined(start, outward=True)
        ends, rest = self._joined(goal, outward=False)
        with ThreadPoolExecutor(_THREADS) as pool:
            self._pool = pool
            try:
                self._bounds_towards(goal, ends, rest)
                found = self._search(start, goal, begins, first, ends, rest)
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
        direct = self._direct(start, goal)
        if direct < math.inf and (found is None or direct <= found.energy_j):  # a path over a centre may be a detour
            return TiledPath(
                np.vstack([start, goal]), direct, direct, 0 if found is None else found.expanded, self._priced
            )
        if found is None:
            raise no_route(self._stored.robot, self._expanded)
        return found

    def _part_around(self, point: Points) -> tuple[CostLattice, NDArray[np.int64]]:
        """The lattice around a point, and its first cell."""
        rows, cols = self._stored.frame.shape
        row, col = (max(math.floor(p) - 2, 0) for p in point)
        part = self._stored.window(row, min(row + 6, rows), col, min(col + 6, cols))
        return part if self._coarse is not None else _of_distances(part), np.array([row, col])

    def _direct(self, start: Points, goal: Points) -> float:
        part, corner = self._part_around(start)
        return direct_energy(part, start - corner, goal - corner) if math.dist(start, goal) <= 1.0 else math.inf

    def _joined(self, point: Points, *, outward: bool) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, 2) cells around a point and (n,) energy of the leg to or from each."""
        part, corner = self._part_around(point)
        cells, legs = joining_legs(part, point - corner, outward=outward)
        usable = np.isfinite(legs)
        return cells[usable] + corner, legs[usable]

    def _numbers(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        tile = cells // self._side @ np.array([self._tile_cols, 1])
        inner = cells % self._side @ np.array([self._side, 1])
        return tile * self._side**2 + inner

    def _bounds_towards(self, goal: Points, ends: NDArray[np.int64], rest: NDArray[np.float64]) -> None:
        """Find the potentials and their constants."""
        offsets, spacing = self._moves.offsets, self._stored.frame.resolution_m
        if self._coarse is None:
            self._goal = goal
            self._normals = _normals(offsets) * spacing
            away = np.abs((ends - goal) @ self._normals.T).max(axis=1) if len(ends) else np.zeros(0)
            self._slack = float((rest - away).min(initial=0.0))
            return
        unit = offsets / np.hypot(offsets[:, :1], offsets[:, 1:])
        self._potentials = potentials_towards(self._coarse, goal, unit, spacing)
        if not self._potentials:
            raise InputError(
                "the energy that comes back on descents is so large here that nothing can be proven from the coarse "
                "level: plan on this map in memory, or lower the robot's `regeneration`"
            )
        self._nodes = np.stack([potential.nodes_j for potential in self._potentials])
        self._shares = np.array([potential.share for potential in self._potentials])
        self._constants = np.array([self._constant(potential, ends, rest) for potential in self._potentials])

    def _constant(self, potential: Potential, ends: NDArray[np.int64], rest: NDArray[np.float64]) -> float:
        """The largest constant for which the bound is none too high at any cell that is joined to the goal."""
        assert self._coarse is not None
        largest = math.inf
        for (row, col), more in zip(ends.tolist(), rest.tolist(), strict=True):
            here = np.empty((1, 1), dtype=np.float32)
            surface = np.asarray(self._coarse.surface[row : row + 1, col : col + 1])
            share = np.array([potential.share])
            fill_bounds(here, surface, row, col, potential.nodes_j[None], share, np.zeros(1), self._coarse.block_cells)
            largest = min(largest, more - float(here[0, 0]))
        return largest if math.isfinite(largest) else 0.0

    def _search(
        self,
        start: Points,
        goal: Points,
        begins: NDArray[np.int64],
        first: NDArray[np.float64],
        ends: NDArray[np.int64],
        rest: NDArray[np.float64],
    ) -> TiledPath | None:
        energy, ahead, pred = self._labels
        seeds, targets = self._numbers(begins), self._numbers(ends)
        for tile in np.unique(np.concatenate([seeds, targets]) >> (2 * self._shift)).tolist():
            self._open(tile)
        state, energies = np.array([0, -1]), np.array([math.inf, -math.inf])
        for cell, cost in zip(seeds.tolist(), first.tolist(), strict=True):
            if cost < energy[cell]:
                energy[cell], pred[cell] = cost, kernels.WAITS
                tile = cell >> (2 * self._shift)
                self._least[tile] = min(self._least[tile], cost + float(ahead[cell]))
        typical = self._typical(begins)
        whole = max(float(ahead[seeds].min(initial=math.inf)), 1e-9)
        while True:
            thickness = typical * (_THIN if self._free else _THICK)
            code, tile = kernels.advance(
                energy, ahead, pred, self._least, self._slot_of, self._opened, self._used, self._prices, self._shift,
                self._tile_cols, self._moves.offsets, state, energies, targets, rest, thickness, _STEPS,
            )  # fmt: skip
            if code == kernels.DONE:
                break
            if code == kernels.LOAD:
                self._load(tile, int(state[kernels.EXPANDED]))
                if self._progress is not None:
                    self._progress(self._share_done(tile, whole))
            elif code == kernels.OPEN:
                self._open(tile)
            self._look_ahead(float(energies[kernels.TOTAL]))
        self._expanded = int(state[kernels.EXPANDED])
        if not math.isfinite(energies[kernels.TOTAL]):
            return None
        cells = kernels.traced(pred, int(state[kernels.LAST]), self._shift, self._tile_cols, self._moves.offsets)
        points = np.vstack([start, cells[::-1].astype(np.float64), goal])
        rounding = 2.0 * _EPS * max(abs(whole), abs(float(energies[kernels.TOTAL])))
        return TiledPath(
            without_repeats(points),
            float(energies[kernels.TOTAL]),
            float(energies[kernels.TOTAL]) - rounding,
            self._expanded,
            self._priced,
        )

    def _share_done(self, tile: int, whole: float) -> float:
        cells = slice(tile * self._side**2, (tile + 1) * self._side**2)
        self._nearest = min(getattr(self, "_nearest", whole), max(float(self._labels[1][cells].min()), 0.0))
        return min(max(1.0 - self._nearest / whole, 0.0), 1.0)

    def _typical(self, begins: NDArray[np.int64]) -> float:
        """A usual price of a move [J], from where the search begins; 1 where there is none."""
        if not len(begins):
            return 1.0
        row, col = begins[0].tolist()
        part = self._window(row - 16, row + 17, col - 16, col + 17)
        mean = float(np.abs(part[np.isfinite(part)]).mean()) if np.isfinite(part).any() else 0.0
        return mean or 1.0

    def _window(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        """(N, rows, cols) energies of the moves that start in a window."""
        if self._coarse is None:
            return self._moves.lengths(self._stored.limits(row0, row1, col0, col1))
        what = ("traction_per_m", "gradient", "blocked")
        return self._moves.energies(self._stored.window(row0, row1, col0, col1, what=what))

    def _corner(self, tile: int) -> tuple[int, int]:
        down, right = divmod(tile, self._tile_cols)
        return down * self._side, right * self._side

    def _price(self, tile: int) -> NDArray[np.float32]:
        """(cells of a tile, N) energies."""
        (row, col), reach = self._corner(tile), self._moves.reach
        planes = self._window(row - reach, row + self._side + reach, col - reach, col + self._side + reach)
        inner = planes[:, reach:-reach, reach:-reach].reshape(len(planes), -1)
        return np.ascontiguousarray(inner.T)

    def _load(self, tile: int, now: int) -> None:
        """Put the prices of a tile into a slot."""
        prices = self._ahead.pop(tile).result() if tile in self._ahead else self._price(tile)
        if not self._free:
            held = np.flatnonzero(self._slot_of >= 0)
            for oldest in held[np.argsort(self._used[held])][: max(len(held) // 16, 1)].tolist():
                self._free.append(int(self._slot_of[oldest]))
                self._slot_of[oldest] = -1
        slot = self._free.pop()
        self._prices[slot] = prices
        self._slot_of[tile], self._used[tile] = slot, now
        self._priced += 1

    def _look_ahead(self, total_j: float) -> None:
        """Begin to price the tiles that are next, as it looks now."""
        waiting = np.flatnonzero((self._least < total_j) & (self._slot_of < 0))
        for tile in waiting[np.argsort(self._least[waiting])][:_NEXT].tolist():
            if tile not in self._ahead:
                if len(self._ahead) >= _MOST_AHEAD:
                    self._ahead.popitem(last=False)[1].cancel()
                self._ahead[tile] = self._pool.submit(self._price, tile)

    def _open(self, tile: int) -> None:
        """Make the labels and bounds of a tile."""
        needed = (int(self._opened.sum()) + 1) * _LABEL_BYTES * self._side**2 + self._prices.nbytes
        if needed > self._memory:
            raise TooLargeError(
                f"the search needs more than the {self._memory / 1e9:.2g} GB that it may use: allow it more memory, or "
                "ask for a nearer goal",
                limit=self._memory,
            )
        energy, ahead, pred = self._labels
        cells = slice(tile * self._side**2, (tile + 1) * self._side**2)
        energy[cells], pred[cells] = math.inf, 0
        ahead[cells] = (self._bounded.pop(tile).result() if tile in self._bounded else self._bounds(tile)).ravel()
        self._opened[tile] = True
        for other in self._around(tile):
            if not self._opened[other] and other not in self._bounded:
                self._bounded[other] = self._pool.submit(self._bounds, other)

    def _around(self, tile: int) -> list[int]:
        """The tiles beside a tile."""
        down, right = divmod(tile, self._tile_cols)
        return [
            r * self._tile_cols + c
            for r in range(max(down - 1, 0), min(down + 2, self._tiles // self._tile_cols))
            for c in range(max(right - 1, 0), min(right + 2, self._tile_cols))
        ]

    def _bounds(self, tile: int) -> NDArray[np.float32]:
        """(side, side) lower bounds of the energy from the cells of a tile to the goal [J]."""
        ahead = np.zeros((self._side, self._side), dtype=np.float32)
        row, col = self._corner(tile)
        if self._coarse is None:
            self._fill_distances(ahead, row, col)
            return ahead
        rows, cols = (min(n - at, self._side) for n, at in zip(self._stored.frame.shape, (row, col), strict=True))
        surface = self._stored.read(self._coarse.surface, 0.0, row, row + rows, col, col + cols)
        fill_bounds(
            ahead[:rows, :cols], surface, row, col, self._nodes, self._shares, self._constants, self._coarse.block_cells
        )
        return ahead

    def _fill_distances(self, ahead: NDArray[np.float32], row: int, col: int) -> None:
        down = np.arange(row, row + self._side)[:, None] - self._goal[0]
        right = np.arange(col, col + self._side)[None, :] - self._goal[1]
        ahead[:] = 0.0
        for normal in self._normals:
            np.maximum(ahead, (normal[0] * down + normal[1] * right).astype(np.float32), out=ahead)
        ahead += np.float32(self._slack)


def _normals(offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N, 2) w with max over w of w . d the length of the shortest way over grid moves to a cell at d."""
    length = np.hypot(offsets[:, 0], offsets[:, 1])
    pairs = [
        np.linalg.solve(offsets[[k, (k + 1) % len(offsets)]].astype(np.float64), length[[k, (k + 1) % len(offsets)]])
        for k in range(len(offsets))
    ]
    return np.array(pairs)


def _of_distances(part: CostLattice) -> CostLattice:
    """The same limits at a price of 1 J/m."""
    robot = replace(part.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
    return replace(part, robot=robot, traction_per_m=np.zeros(part.traction_per_m.shape, dtype=np.float32))
