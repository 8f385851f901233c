"""Figures of a lattice: the range of its prices, and how much of it is blocked and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from joulemap.planner.lattice import Blocked, CostLattice


def figures_of(lattice: CostLattice) -> dict[str, Any]:
    """Return what `joined_figures` needs of a part of a lattice.

    Result: JSON-able: `min`, `max` and `total` of the prices [J/m] of all (cell, heading) pairs that may be driven, the
    first two None where there is none; `counts`, the pairs under each `Blocked` code.
    """
    codes = lattice.blocked_by_heading()
    prices = lattice.robot.price_per_m(lattice.traction_per_m[codes == Blocked.FREE].astype(np.float64))
    return {
        "min": float(prices.min()) if prices.size else None,
        "max": float(prices.max()) if prices.size else None,
        "total": float(prices.sum()),
        "counts": np.bincount(codes.ravel(), minlength=len(Blocked)).tolist(),
    }


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
