"""A speed for each stretch of a route: least energy, or least energy within a deadline, with acceleration paid for.

    E = sum over metres of (P / v + price(t(v) + dK / L)) dx,    T = sum of dx / v

`t(v)` is the traction at a speed, `P` the idle power, and `dK` the change of kinetic energy over a stretch of length
`L`. Dynamic programming over stretches and speeds finds the least E + lambda T, and bisection the lambda of a deadline.

Reference: Bellman 1957, "Dynamic programming"; Everett 1963, "Generalized Lagrange multiplier method".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.robot import Robot

FloatArray = NDArray[np.float64]
STRETCH_M = 5.0
"""Setting: shortest length with one speed [m]; momentum is not used up within it."""
_HALVINGS = 40


@dataclass(frozen=True)
class SpeedProfile:
    """A speed for each stretch of a route.

    Attributes
    ----------
    until_m : tuple of float
        Where each stretch ends, from the start [m].
    speed_mps : tuple of float
        Its speed [m/s].
    energy_j : float
        Energy, idle power and changes of speed included, turns not [J]. Motion that is left at the end counts as
        returned, and that of the beginning as spent, so that one speed costs what it costs in the middle of a drive.
    duration_s : float
        Time, turns on the spot not counted [s].
    """

    until_m: tuple[float, ...]
    speed_mps: tuple[float, ...]
    energy_j: float
    duration_s: float


def speed_profile(
    traction_per_m: FloatArray,
    length_m: FloatArray,
    speeds_mps: FloatArray,
    robot: Robot,
    *,
    deadline_s: float | None = None,
) -> SpeedProfile:
    """Find the speeds of least energy, each one of `speeds_mps` (S,), ascending [m/s].

    `traction_per_m` (S, n): of each piece of a route at each speed [J/m]; `length_m` (n,). Raises InputError where the
    fastest speed takes longer than the deadline.
    """
    total = float(length_m.sum())
    fastest_s = total / float(speeds_mps[-1])
    if deadline_s is not None and deadline_s < fastest_s:
        raise InputError(
            f"the deadline of {deadline_s:g} s is shorter than {fastest_s:.1f} s, which the route takes at the fastest "
            f"speed that the model knows, {speeds_mps[-1]:.3g} m/s",
            deadline_s=deadline_s,
            limit=fastest_s,
        )
    ends = np.cumsum(length_m)
    stretch = np.minimum(((ends - 0.5 * length_m) / STRETCH_M).astype(np.int64), max(int(total / STRETCH_M) - 1, 0))
    stretch, kinetic_j = np.unique(stretch, return_inverse=True)[1], 0.5 * robot.mass_kg * speeds_mps**2
    traction = np.ascontiguousarray(traction_per_m, dtype=np.float64)
    idle_per_m = robot.idle_power_w / speeds_mps
    costs = _stretch_costs(traction, length_m, stretch, kinetic_j, idle_per_m, robot.regeneration)
    costs[0] = np.diag(np.diag(costs[0]) + kinetic_j)  # the first speed is there from the beginning
    costs[-1] -= kinetic_j
    spans = np.bincount(stretch, weights=length_m)
    times = spans[:, None] / speeds_mps

    def _found(weight: float) -> tuple[NDArray[np.int64], float]:
        chosen = _cheapest(costs, times, weight)
        return chosen, float(times[np.arange(len(chosen)), chosen].sum())

    chosen, duration = _found(0.0)
    if deadline_s is not None and duration > deadline_s:
        low, high = 0.0, 1.0
        while _found(high)[1] > deadline_s and high < 1e12:
            low, high = high, 4.0 * high
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if _found(middle)[1] > deadline_s else (low, middle)
        chosen, duration = _found(high)
    steps = zip([chosen[0], *chosen[:-1]], chosen, strict=True)
    energy = sum(float(costs[k, a, b]) for k, (a, b) in enumerate(steps))
    last = np.flatnonzero(np.append(np.diff(chosen) != 0, True))
    until = np.cumsum(spans)[last]
    return SpeedProfile(tuple(until.tolist()), tuple(speeds_mps[chosen[last]].tolist()), energy, duration)


@njit(cache=True)
def _stretch_costs(traction, length_m, stretch, kinetic_j, idle_per_m, regeneration):
    """Energy [J] of each stretch that is entered at one speed and driven at another, (stretches, S, S)."""
    count, speeds = stretch[-1] + 1, kinetic_j.size
    out = np.zeros((count, speeds, speeds))
    spans = np.zeros(count)
    for i in range(length_m.size):
        spans[stretch[i]] += length_m[i]
    for i in range(length_m.size):
        k = stretch[i]
        for before in range(speeds):
            for now in range(speeds):
                t = traction[now, i] + (kinetic_j[now] - kinetic_j[before]) / spans[k]
                out[k, before, now] += length_m[i] * (idle_per_m[now] + (t if t > 0.0 else regeneration * t))
    return out


@njit(cache=True)
def _cheapest(costs, times, weight):
    """The speed of each stretch under which energy and weighted time are least; the first speed is there already."""
    count, speeds = times.shape
    least = np.empty(speeds)
    came = np.zeros((count, speeds), dtype=np.int64)
    for now in range(speeds):
        least[now] = costs[0, now, now] + weight * times[0, now]
    for k in range(1, count):
        following = np.empty(speeds)
        for now in range(speeds):
            best = np.inf
            for before in range(speeds):
                cost = least[before] + costs[k, before, now]
                if cost < best:
                    best, came[k, now] = cost, before
            following[now] = best + weight * times[k, now]
        least = following
    chosen = np.zeros(count, dtype=np.int64)
    chosen[-1] = np.argmin(least)
    for k in range(count - 1, 0, -1):
        chosen[k - 1] = came[k, chosen[k]]
    return chosen
