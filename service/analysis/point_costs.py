"""What driving costs at one place of a cost map, in every direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from joulemap.model.frames import heading_bins
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import energy_per_m_at


@dataclass(frozen=True, eq=False)
class PointCosts:
    """What driving costs at one place.

    Attributes
    ----------
    headings_rad : ndarray of float64, (K,)
        Clockwise from north [rad].
    energy_per_m : ndarray of float64, (K,)
        Energy per metre [J/m], NaN where driving is not allowed.
    reasons : list of str or None, (K,)
        Why driving is not allowed in a heading; None where it is.
    elevation_m : float
        Height of the cell [m], NaN where unknown.
    """

    headings_rad: np.ndarray
    energy_per_m: np.ndarray
    reasons: list[str | None]
    elevation_m: float


def costs_at(lattice: CostLattice, x: float, y: float) -> PointCosts:
    """Return the energy per metre in all headings at one place, and why some headings are blocked.

    The energy is interpolated as for the price of a path, between up to four cells. The reason is that of the nearest
    of these cells that is blocked.

    `x`, `y`: world coordinates [m].
    """
    row, col = lattice.frame.cell_of(x, y)
    headings = heading_bins(lattice.headings)
    energy = energy_per_m_at(lattice, x, y, headings)
    at_row, at_col = (float(v) for v in lattice.frame.rowcol(x, y))
    near = [
        (r, c)
        for r in range(max(int(np.floor(at_row)), 0), min(int(np.floor(at_row)) + 2, lattice.frame.rows))
        for c in range(max(int(np.floor(at_col)), 0), min(int(np.floor(at_col)) + 2, lattice.frame.cols))
    ]
    near.sort(key=lambda cell: (cell[0] - at_row) ** 2 + (cell[1] - at_col) ** 2)
    codes = np.stack([lattice.window(r, r + 1, c, c + 1).blocked_by_heading()[0, 0] for r, c in near])  # (cells, K)
    reasons: list[str | None] = []
    for k in range(lattice.headings):
        if np.isfinite(energy[k]):
            reasons.append(None)
        else:
            blocked = codes[:, k][codes[:, k] != Blocked.FREE]
            reasons.append(Blocked(int(blocked[0])).label if blocked.size else Blocked.UNKNOWN.label)
    return PointCosts(headings, energy, reasons, float(lattice.elevation_m[row, col]))
