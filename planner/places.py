"""Where a route may begin or end: the point itself, its cell's centre, or the nearest free place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError
from joulemap.model.threads import share_out
from joulemap.planner.grid.search import joining_legs
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices_between
from joulemap.planner.pricing.potential import parts_of

FURTHEST_CELLS = 1000
"""Half the side of the largest window in which a free place is looked for."""

_FIRST_HALF_CELLS = 4
_AT_ONCE = 256
_NEIGHBOURS = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)], dtype=np.float64)


def check_place(lattice: CostLattice, x: float, y: float, *, name: str) -> tuple[int, int]:
    """Return the cell under a world point, if it may be driven in some heading.

    `x`, `y`: world point [m]. Raises BlockedError if every heading is blocked.
    """
    row, col = lattice.frame.cell_of(x, y, name=name)
    codes = _codes(lattice, row, col)
    if not codes.all():
        return row, col
    reason = Blocked(int(codes.min()))
    message = f"{name} ({x:.2f}, {y:.2f}) is on blocked ground: {reason.label.replace('_', ' ')}"
    context = {"which": name, "x": x, "y": y, "reason": reason.label}
    nearest = nearest_free(lattice, x, y)
    if nearest is None:
        raise BlockedError(f"{message}; there is no free place near it", **context)
    free_x, free_y, away_m = nearest
    raise BlockedError(
        f"{message}; the nearest free place is ({free_x:.2f}, {free_y:.2f}), {away_m:.2f} m away",
        **context,
        nearest=[free_x, free_y],
        nearest_m=away_m,
    )


def free_places(lattice: CostLattice) -> NDArray[np.bool_]:
    """Return which cells may be driven in some heading: where `check_place` raises nothing.

    The result is (rows, cols).
    """
    free = np.empty(lattice.frame.shape, dtype=np.bool_)

    def _fill(part: slice) -> None:
        free[part] = (lattice.window(part.start, part.stop).blocked_by_heading() == Blocked.FREE).any(axis=2)

    share_out(_fill, parts_of(*lattice.frame.shape))
    return free


def end_point(lattice: CostLattice, x: float, y: float, *, name: str, snap: bool = False) -> tuple[Points, str | None]:
    """Return where a route to or from a world point ends or begins.

    That is the point itself if some leg joins it to a neighbouring cell centre, else (it is next to blocked ground) the
    centre of its own cell.

    `x`, `y`: world point [m]. Returns `point` (2,): fractional (row, col); `note`: where the point was moved to, if it
    was. Raises BlockedError if the point is on blocked ground, and `snap` is off or finds nothing.
    """
    try:
        cell = check_place(lattice, x, y, name=name)
    except BlockedError as error:
        if not snap or "nearest" not in error.context:
            raise
        free_x, free_y = error.context["nearest"]
        place = np.array(lattice.frame.cell_of(free_x, free_y), dtype=np.float64)
        why = str(error.context["reason"]).replace("_", " ")
        return place, (
            f"{name} ({x:.2f}, {y:.2f}) is on blocked ground ({why}) and was moved to the nearest free place, "
            f"({free_x:.2f}, {free_y:.2f}), {error.context['nearest_m']:.2f} m away"
        )
    row, col = lattice.frame.rowcol(x, y)
    point = np.array([float(row), float(col)])
    _, legs = joining_legs(lattice, point, outward=True)
    if np.isfinite(legs).any():
        return point, None
    centre = np.array(cell, dtype=np.float64)
    x, y = (float(v) for v in lattice.frame.xy(*centre))
    return centre, f"{name} is next to blocked ground and was moved to the centre of its cell, ({x:.2f}, {y:.2f})"


def nearest_free(
    lattice: CostLattice, x: float, y: float, *, furthest_cells: int = FURTHEST_CELLS
) -> tuple[float, float, float] | None:
    """Return the nearest cell centre from which, and to which, the robot may drive.

    `x`, `y`: world point [m]. Result: world x, y [m] of the centre and its distance [m]; None where there is none in
    the window.

    The window around the point grows until it holds the answer, so the work is proportional to the area of the circle
    around the point in which nothing is free.
    """
    row, col = lattice.frame.rowcol(x, y)
    point = np.array([float(row), float(col)])
    furthest = min(furthest_cells, max(lattice.frame.shape))
    half = min(_FIRST_HALF_CELLS, furthest)
    while True:
        cell = _nearest_in_window(lattice, point, half)
        away = math.inf if cell is None else float(np.hypot(*(cell - point)))
        if cell is not None and (away <= half or half >= furthest):
            free_x, free_y = (float(v) for v in lattice.frame.xy(*cell))
            return free_x, free_y, math.dist((x, y), (free_x, free_y))
        if half >= furthest:
            return None
        # beyond the window's sides, nearer than its corners, there may be a nearer one
        half = min(2 * half if cell is None else math.ceil(away), furthest)


def _nearest_in_window(lattice: CostLattice, point: Points, half: int) -> NDArray[np.int64] | None:
    low = np.maximum(np.floor(point).astype(np.int64) - half, 0)
    high = np.floor(point).astype(np.int64) + half + 2
    cells = np.argwhere(lattice.blocked[low[0] : high[0], low[1] : high[1]] == Blocked.FREE) + low
    cells = cells[np.argsort(np.hypot(*(cells - point).T), kind="stable")]
    for first in range(0, len(cells), _AT_ONCE):
        some = cells[first : first + _AT_ONCE]
        starts = np.repeat(some.astype(np.float64), len(_NEIGHBOURS), axis=0)
        ends = starts + np.tile(_NEIGHBOURS, (len(some), 1))
        legs = np.stack([leg_prices_between(lattice, starts, ends), leg_prices_between(lattice, ends, starts)])
        both_ways = np.isfinite(legs).reshape(2, len(some), -1).any(axis=2).all(axis=0)
        for cell in some[both_ways]:
            if not _codes(lattice, *cell).all():
                return cell
    return None


def _codes(lattice: CostLattice, row: int, col: int) -> NDArray[np.uint8]:
    """(headings,) `Blocked` codes of one cell."""
    return lattice.window(row, row + 1, col, col + 1).blocked_by_heading()[0, 0]
