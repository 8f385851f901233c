"""The distribution of a route's energy: the lattice's standard deviations joined with the model's error per run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.energy.uncertainty import Spread
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.planner.verdict.energy_distribution import QUANTILES, EnergyOdds


def odds_along(routes: Sequence[Route]) -> EnergyOdds | None:
    """Return the distribution of the energy along routes that are driven one after another.

    Result: of the energy from the start to the end of each of the n pieces of all profiles; None where the model does
    not know its uncertainty.

    The error that a whole run has in common is fully correlated over all pieces. The rest is fully correlated within a
    metre, and beyond that over the model's correlation length (see `Spread.route_std`).
    """
    profiles = [route.profile for route in routes]
    if routes[0].spread is None or any(profile.std_j is None for profile in profiles):
        return None
    spread = Spread.from_dict(routes[0].spread)
    driven = np.cumsum([0.0, *(route.length_m for route in routes)])
    distance = np.concatenate([[0.0], *(p.distance_m + d for p, d in zip(profiles, driven, strict=False))])
    marks = np.append(np.arange(math.ceil(driven[-1])), driven[-1])
    mean_j, std_j = (
        np.cumsum(np.concatenate([[0.0], *pieces]))
        for pieces in ([p.energy_j for p in profiles], [p.std_j for p in profiles if p.std_j is not None])
    )
    by_metre = [np.diff(np.interp(marks, distance, along)) for along in (mean_j, std_j)]
    scale, freedom = spread.along(*by_metre)
    if freedom is not None:
        freedom = np.interp(distance[1:], marks[1:], freedom) if freedom.size else None  # nothing is driven
    scale_j = np.interp(distance[1:], marks, np.append(0.0, scale))
    return EnergyOdds(mean_j[1:], scale_j, freedom, spread.bias, spread.skew)


def odds_of_energies(lattice: CostLattice, energy_j: ArrayLike) -> EnergyOdds | None:
    """Return the distribution of the energy of routes of which only the energy is known, such as those of a field.

    `energy_j` (n,): expected energies [J]. Result: as if all of it were driven on ground of the lattice's mean energy
    and standard deviation per metre; None where the lattice's model does not know its uncertainty.
    """
    given = lattice.provenance.get("model", {}).get("spread")
    per_metre, std = lattice.mean_per_m
    if given is None or std is None:
        return None
    spread, energy = Spread.from_dict(given), np.asarray(energy_j, dtype=np.float64)
    length_m = np.maximum(energy, 0.0) / max(per_metre, 1e-9)
    of_run = spread.run_variance(energy, std * length_m)
    rest = std**2 * spread.correlation_m * length_m
    return EnergyOdds(energy, np.sqrt(of_run + rest), spread.freedom_of(of_run, rest), spread.bias, spread.skew)


def quantiles_of_route(*routes: Route) -> dict[str, float | None]:
    """Return the distribution of a route's energy as answers have it.

    Result: `energy_std_j`, `energy_p05_j`, `energy_p50_j` and `energy_p95_j` [J], all None where the model does not
    know its uncertainty.
    """
    names = [f"energy_p{100 * share:02.0f}_j" for share in QUANTILES]
    odds = odds_along(routes)
    if odds is None:
        return dict.fromkeys(["energy_std_j", *names])
    return {
        "energy_std_j": odds.final_std_j,
        **{name: odds.final_quantile(share) for name, share in zip(names, QUANTILES, strict=True)},
    }
