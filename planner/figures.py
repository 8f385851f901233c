"""Figures of a lattice: the range of its prices, and how much of it is blocked and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit

from joulemap.model.frames import heading_bins, heading_vector
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.obstacles import MEETS, meets
from joulemap.planner.pricing.integrator import price_terms


def figures_of(lattice: CostLattice) -> dict[str, Any]:
    """Return what `joined_figures` needs of a part of a lattice.

    Result: JSON-able: `min`, `max` and `total` of the prices [J/m] of all (cell, heading) pairs that may be driven, the
    first two None where there is none; `counts`, the pairs under each `Blocked` code.
    """
    counts = np.zeros(len(Blocked), dtype=np.int64)
    least, most, total = _tally(
        lattice.traction_per_m,
        lattice.gradient,
        lattice.closed,
        price_terms(lattice),
        *heading_vector(heading_bins(lattice.headings)),
        int(Blocked.GRADE),
        int(Blocked.CROSS_SLOPE),
        counts,
    )
    free = counts[Blocked.FREE] > 0
    return {"min": least if free else None, "max": most if free else None, "total": total, "counts": counts.tolist()}


def joined_figures(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of a lattice from those of its parts.

    Result: JSON-able: `energy_per_m`, the min, mean and max [J/m] over all (cell, heading) pairs that may be driven,
    None where there is none; `blocked`, the share of all pairs under each reason, `free` included.
    """
    counts = np.sum([part["counts"] for part in parts], axis=0)
    driven = [part for part in parts if part["counts"][Blocked.FREE]]
    energy = (
        {
            "min": min(part["min"] for part in driven),
            "mean": sum(part["total"] for part in driven) / int(counts[Blocked.FREE]),
            "max": max(part["max"] for part in driven),
        }
        if driven
        else None
    )
    return {
        "energy_per_m": energy,
        "blocked": {reason.label: float(counts[reason] / counts.sum()) for reason in Blocked},
    }


@njit(cache=True, nogil=True)
def _tally(traction, gradient, closed, terms, east, north, grade, cross_slope, counts):
    """(least, most, sum) of the prices of free pairs; counts : filled by code, as `CostLattice.blocked_at`."""
    hotel, regeneration, max_grade, max_cross = terms[1], terms[2], terms[3], terms[4]
    least, most, total = math.inf, -math.inf, 0.0
    for i in range(traction.shape[0]):
        for j in range(traction.shape[1]):
            if closed.codes[i, j] != 0:
                counts[closed.codes[i, j]] += east.size
                continue
            near = closed.room.size > 0 and (closed.near.size == 0 or closed.near[i, j])
            to_east, to_north = gradient[i, j, 0], gradient[i, j, 1]
            for k in range(east.size):
                if abs(to_east * east[k] + to_north * north[k]) > max_grade:
                    counts[grade] += 1
                elif abs(to_east * north[k] - to_north * east[k]) > max_cross:
                    counts[cross_slope] += 1
                elif near and meets(closed.room, closed.body, i, j, i, j, east[k], north[k], 0.0):
                    counts[MEETS] += 1
                else:
                    counts[0] += 1
                    demand = np.float64(traction[i, j, k])
                    price = hotel + max(demand, 0.0) + regeneration * min(demand, 0.0)
                    least, most, total = min(least, price), max(most, price), total + price
    return least, most, total
