"""Routes cut from held-out runs, and how well distributions of their energy hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.uncertainty import Spread
from joulemap.planner.verdict.energy_distribution import EnergyOdds

FloatArray = NDArray[np.float64]

LEVELS = (0.5, 0.8, 0.9)
MARGIN = 0.2  # of the verdict to compare with
CHARGES = np.linspace(0.7, 1.5, 17)
"""Energy that there is, over the expected energy: verdicts of every route are judged at all of them."""
CUTS = 10  # times that the runs are cut into routes


@dataclass(frozen=True, eq=False)
class Held:
    """Held-out segments of about 1 m, in driving order."""

    measured: FloatArray
    predicted: FloatArray
    std: FloatArray
    run: NDArray[np.int64]
    group: NDArray[np.int64]


def columns_of(held: Held, rows: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    """What a spread is fitted to."""
    return held.measured[rows], held.predicted[rows], held.std[rows], held.run[rows]


def taken(held: Held, rows: NDArray[np.bool_]) -> Held:
    """Some of the segments."""
    return Held(*(getattr(held, field.name)[rows] for field in fields(Held)))


@dataclass(frozen=True, eq=False)
class Judged:
    """Routes, one entry each: measured energy, and its distribution."""

    name: str
    measured: FloatArray
    odds: EnergyOdds


def judged(name: str, spread: Spread, test: Held, *, shortest: int, longest: int, cuts: int = CUTS) -> Judged:
    """The routes of runs; `std` of the segments is that before `Spread.factor`."""
    rows = []
    for seed in range(cuts):
        for route in _routes(test.run, np.random.default_rng([7, seed]), shortest, longest):
            scale, freedom = spread.along(test.predicted[route], spread.factor * test.std[route])
            mean = float(test.predicted[route].sum())
            rows.append((test.measured[route].sum(), mean, scale[-1], 1e6 if freedom is None else freedom[-1]))
    measured, mean_j, scale_j, degrees = np.array(rows).T
    return Judged(name, measured, EnergyOdds(mean_j, scale_j, degrees, spread.bias, spread.skew))


def _routes(
    run: NDArray[np.int64], rng: np.random.Generator, shortest: int, longest: int
) -> Iterator[NDArray[np.int64]]:
    """Stretches of each run that do not overlap, of lengths whose logarithm is uniform."""
    for one in np.unique(run):
        mine = np.flatnonzero(run == one)
        at = 0
        while mine.size - at >= shortest:
            length = round(float(np.exp(rng.uniform(np.log(shortest), np.log(longest)))))
            yield mine[at : at + length]
            at += length


def scores(parts: Sequence[Judged]) -> dict[str, Any]:
    """Coverage of intervals, Brier scores, and the reliability curve."""
    inside: dict[str, list[NDArray[np.bool_]]] = {f"{100 * level:.0f}": [] for level in LEVELS}
    lasts, ours, plain, careful, below = [], [], [], [], []
    for routes in parts:
        for level in LEVELS:
            low, high = (routes.odds.quantile(0.5 + side * level / 2) for side in (-1, 1))
            inside[f"{100 * level:.0f}"].append((routes.measured >= low) & (routes.measured <= high))
        below.append(routes.measured <= routes.odds.quantile(0.5))
        for charge in CHARGES:
            there = charge * routes.odds.mean_j
            lasts.append(routes.measured <= there)
            ours.append(routes.odds.lasts(there))
            plain.append(there >= routes.odds.mean_j)
            careful.append(there >= (1.0 + MARGIN) * routes.odds.mean_j)
    happened, said = np.concatenate(lasts).astype(float), np.concatenate(ours)
    return {
        "routes": sum(int(routes.measured.size) for routes in parts),
        "coverage": {level: float(np.concatenate(found).mean()) for level, found in inside.items()},
        "below the median": float(np.concatenate(below).mean()),
        "brier": {
            "odds": float(np.mean((said - happened) ** 2)),
            "mean": float(np.mean((np.concatenate(plain) - happened) ** 2)),
            "margin of 20 %": float(np.mean((np.concatenate(careful) - happened) ** 2)),
        },
        "reliability": _reliability(said, happened),
    }


def _reliability(said: FloatArray, happened: FloatArray) -> list[tuple[float, float, int]]:
    """Mean probability, share that lasted, and count, in tenths of the probability."""
    tenth = np.minimum((said * 10).astype(int), 9)
    return [
        (float(said[tenth == k].mean()), float(happened[tenth == k].mean()), int((tenth == k).sum()))
        for k in range(10)
        if (tenth == k).any()
    ]
