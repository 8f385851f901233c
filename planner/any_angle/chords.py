"""Line points, and the straight chords between them: the graph of the any-angle search.

Within a square of four cell centres the traction at a heading is bilinear, and a leg is open where all four cells are;
on a side of the square only two count. So a cheap path is nearly straight across a square and changes its heading on
these sides. Points that divide them, joined by straight chords across a square or along its sides, offer such paths
(Aleksandrov, Maheshwari & Sack 2005: Steiner points on the edges of weighted regions).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import heading_of, heading_vector
from joulemap.planner.pricing.move_prices import leg_stencils

AROUND = 3
"""Rows and columns of cells around a point's cell in which its chords end, and whose tractions they need."""


class Chords(NamedTuple):
    """Chords between line points. A cell has `kinds` of these: its centre, those on the side to the right, those below.

    Attributes
    ----------
    places : ndarray of float64, (kinds, 2)
        (row, col) of each kind from the centre of its cell [cells].
    first : ndarray of int64, (kinds + 1,)
        The first chord from each kind, and the number of all.
    cell : ndarray of uint8, (C,)
        The cell of a chord's end, by its number among the nine around that of the beginning.
    kind : ndarray of uint8, (C,)
        Kind of its end.
    heading : ndarray of uint16, (C,)
        Number of its heading.
    length : ndarray of float64, (C,)
        Length [cells].
    corners : ndarray of uint8, (C, 4)
        Cells that it touches, by their number among the nine; one of them again where there are fewer.
    other_corners : ndarray of bool, (C,)
        Whether these are others than those of the chord before.
    share : ndarray of float64, (C, 4)
        Share of each of these in the mean of the traction.
    blend : ndarray of float64, (C, 3, 4)
        Weights of these at its beginning, middle and end.
    directions : ndarray of float64, (H, 2)
        East and north component of each heading.
    heading_rad : ndarray of float64, (H,)
        The headings.
    beside : ndarray of int64, (C, B, 2)
        Further cells that it touches when it is shifted to its sides by up to the margin and longer by it at both
        ends: rows and columns from the cell of its beginning; repeated where there are fewer.
    """

    places: NDArray[np.float64]
    first: NDArray[np.int64]
    cell: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    heading: NDArray[np.uint16]
    length: NDArray[np.float64]
    corners: NDArray[np.uint8]
    other_corners: NDArray[np.bool_]
    share: NDArray[np.float64]
    blend: NDArray[np.float64]
    directions: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    beside: NDArray[np.int64]


@lru_cache(maxsize=8)
def chords_of(parts: int, margin: float = 0.0) -> Chords:
    """The chords between points that divide each side of a square into `parts`.

    They lead across squares from each point to all on other sides, and along sides to the next point. margin : how far
    to their sides other cells count [cells].
    """
    whole = range(parts + 1)
    border = [(a, b) for a in whole for b in whole if a in (0, parts) or b in (0, parts)]
    kinds = [(0, 0), *((0, k) for k in range(1, parts)), *((k, 0) for k in range(1, parts))]
    headings: dict[tuple[int, int], int] = {}
    first, rows = [0], []
    for row, col in kinds:
        for up, left in np.ndindex(1 if row else 2, 1 if col else 2):  # squares on whose border the point is
            here = np.array([row + up * parts, col + left * parts])
            for there in np.array(border):
                step = there - here
                along = (step == 0) & (here % parts == 0)
                if not step.any() or (along.any() and (np.abs(step).sum() > 1 or here[along] != 0)):
                    continue  # along a side only to the next point, and once for both squares beside it
                u, v = (np.linspace(a, b, 3) / parts for a, b in zip(here, there, strict=True))
                blend = np.column_stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])
                touched = blend.any(axis=0)
                cells = np.array([_number(i - up, j - left) for i, j in np.ndindex(2, 2)])
                owner, end = np.divmod(there, parts)
                direction = tuple((step // math.gcd(*step.tolist())).tolist())
                rows.append(
                    (
                        _number(*(owner - (up, left))),
                        kinds.index(tuple(end.tolist())),
                        headings.setdefault(direction, len(headings)),
                        math.hypot(*step) / parts,
                        np.where(touched, cells, cells[touched][0]),
                        (blend[0] + 4.0 * blend[1] + blend[2]) / 6.0,
                        blend,
                    )
                )
        rows[first[-1] :] = sorted(rows[first[-1] :], key=lambda row: tuple(row[4]))
        first.append(len(rows))
    down, right = np.array(list(headings)).T
    heading_rad = heading_of(right, -down)
    cell, kind, heading, length, corners, share, weights = (np.array(column) for column in zip(*rows, strict=True))
    other_corners = np.append(True, (corners[1:] != corners[:-1]).any(axis=1))
    other_corners[first[:-1]] = True
    directions, places = np.column_stack(heading_vector(heading_rad)), np.array(kinds) / parts
    beside = _beside(np.repeat(places, np.diff(first), axis=0), directions[heading], length, corners, margin)
    return Chords(
        places,
        np.array(first),
        cell.astype(np.uint8),
        kind.astype(np.uint8),
        heading.astype(np.uint16),
        length,
        corners.astype(np.uint8),
        other_corners,
        share,
        weights,
        directions,
        heading_rad,
        beside,
    )


def _beside(
    begins: NDArray[np.float64],
    directions: NDArray[np.float64],
    length: NDArray[np.float64],
    corners: NDArray[np.int64],
    margin: float,
) -> NDArray[np.int64]:
    """The cells that chords touch when they are shifted and longer, (C, B, 2); B = 0 without a margin."""
    if margin == 0.0:
        return np.zeros((len(begins), 0, 2), dtype=np.int64)
    step = length[:, None] * np.column_stack([-directions[:, 1], directions[:, 0]])  # rows run south
    along = step / length[:, None]
    side = np.column_stack([along[:, 1], -along[:, 0]])
    touched: list[set[tuple[int, int]]] = [set() for _ in begins]
    steps = math.ceil(margin)
    for k in range(-steps, steps + 1):
        cells, shares = leg_stencils(
            np.hstack([begins + margin * (k / steps * side - along), step + 2.0 * margin * along])
        )
        for number, (row_col, share) in enumerate(zip(cells.tolist(), shares.tolist(), strict=True)):
            touched[number] |= {tuple(cell) for cell, part in zip(row_col, share, strict=True) if part >= 0.0}
    own = [{(int(n) // AROUND - 1, int(n) % AROUND - 1) for n in four} for four in corners]
    others = [sorted(cells - mine) or sorted(mine)[:1] for cells, mine in zip(touched, own, strict=True)]
    widest = max(map(len, others))
    return np.array([(cells * widest)[:widest] for cells in others], dtype=np.int64)


def _number(down: int, right: int) -> int:
    """The number of a cell among the nine around another."""
    return AROUND * (down + 1) + right + 1
