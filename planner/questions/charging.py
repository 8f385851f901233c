"""The cheapest way over charging places that never falls below the reserve: labels over places, not over cells."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Charging:
    """How batteries are filled at every charging place.

    Attributes
    ----------
    power_w : float or None
        Power into the battery [W]; None where batteries are swapped for full ones.
    stop_s : float
        Time that every stop takes beside charging: docking, or the swap [s].
    """

    power_w: float | None
    stop_s: float


@dataclass(frozen=True)
class Hop:
    """A way to the next place.

    Attributes
    ----------
    start, goal : int
        Numbers of places.
    charged_j : float
        Energy that is charged before it [J].
    waits_s : float
        How long that takes [s].
    left_j : float
        Energy above the reserve with which it begins [J].
    """

    start: int
    goal: int
    charged_j: float
    waits_s: float
    left_j: float


def cheapest_chain(
    energy_j: FloatArray,
    need_j: FloatArray,
    seconds: FloatArray,
    charging: Charging,
    *,
    available_j: float,
    full_j: float,
    quickest: bool = False,
) -> list[Hop] | None:
    """Return the ways of least energy from the first place to the last one, charging at places between.

    `energy_j` (n, n): expected energy from each place to each other one [J], infinite where there is no way; `need_j`
    (n, n): what must be in the battery above the reserve for it [J]; `seconds` (n, n): driving time [s]; `available_j`,
    `full_j`: energy above the reserve at the start, and of a full battery [J]; `quickest`: least time instead, charging
    included. Result: None where no chain of places reaches the last one.

    At a place is charged what the next way needs, no more: what comes after it begins at a place that charges too.
    A label is a place, what it cost to come there, and what is left in the battery; labels that cost no less and have
    no more left than another one at their place are dropped.

    Reference: Martins 1984, "On a multicriteria shortest path problem".
    """
    last, numbers = len(energy_j) - 1, count()
    open_labels: list[tuple[tuple[float, float], int, int, float, tuple[Hop, ...]]] = [
        ((0.0, 0.0), next(numbers), 0, available_j, ())
    ]
    settled: list[list[tuple[tuple[float, float], float]]] = [[] for _ in range(last + 1)]
    while open_labels:
        cost, _, here, left, hops = heapq.heappop(open_labels)
        if here == last:
            return list(hops)
        if any(other <= cost and more >= left for other, more in settled[here]):
            continue
        settled[here].append((cost, left))
        for there in range(1, last + 1):
            if there == here or not np.isfinite(energy_j[here, there]):
                continue
            for hop in _hops(here, there, float(need_j[here, there]), left, charging, full_j):
                energy, time = float(energy_j[here, there]), hop.waits_s + float(seconds[here, there])
                cheap = max(energy, 0.0)  # a way that returns energy is free: labels are settled in their order
                spent = (cost[0] + time, cost[1] + cheap) if quickest else (cost[0] + cheap, cost[1] + time)
                label = spent, next(numbers), there, min(hop.left_j - energy, full_j), (*hops, hop)
                heapq.heappush(open_labels, label)
    return None


def _hops(here: int, there: int, need: float, left: float, charging: Charging, full: float) -> Iterator[Hop]:
    """The ways in which a battery may be ready for the way to the next place."""
    if need <= left:
        yield Hop(here, there, 0.0, 0.0, left)
    if here == 0 or need > full:
        return
    if charging.power_w is None and left < full:
        yield Hop(here, there, full - left, charging.stop_s, full)
    elif charging.power_w is not None and need > left:
        yield Hop(here, there, need - left, charging.stop_s + (need - left) / charging.power_w, need)
