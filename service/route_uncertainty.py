"""The uncertainty of a route's energy: the lattice's standard deviations joined with the model's error per run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.uncertainty import Spread
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route


def std_along(lattice: CostLattice, routes: Sequence[Route]) -> NDArray[np.float64] | None:
    """Return the standard deviation of the energy along routes that are driven one after another.

    Parameters
    ----------
    lattice : CostLattice
        That all routes were priced with.
    routes : sequence of Route
        In the order of driving.

    Returns
    -------
    ndarray of float64, (n,), or None
        Standard deviation [J] of the energy from the start to the end of each of the n pieces of all profiles; None
        where the lattice's model does not know its uncertainty.

    Notes
    -----
    The error that a whole run has in common is fully correlated over all pieces. The rest is fully correlated within a
    metre, and beyond that over the model's correlation length (see `Spread.route_std`).
    """
    spread = lattice.provenance.get("model", {}).get("spread")
    if spread is None or lattice.std_j is None:
        return None
    profiles = [route.profile for route in routes]
    driven = np.cumsum([0.0, *(route.length_m for route in routes)])
    distance = np.concatenate([[0.0], *(p.distance_m + d for p, d in zip(profiles, driven, strict=False))])
    marks = np.append(np.arange(math.ceil(driven[-1])), driven[-1])
    by_metre = [
        np.diff(np.interp(marks, distance, np.cumsum(np.concatenate([[0.0], *pieces]))))
        for pieces in ([p.energy_j for p in profiles], [p.std_j for p in profiles if p.std_j is not None])
    ]
    along = np.append(0.0, Spread.from_dict(spread).route_std(*by_metre))
    return np.interp(distance[1:], marks, along)
