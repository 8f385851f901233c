"""Battery verdicts: will the energy last, and what is left?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from model.robot import Battery


@dataclass(frozen=True)
class Verdict:
    """Whether a battery lasts for a task.

    energy_j : energy the task asks for; available_j : energy above the reserve at the start; margin_j : what is left of
    it (0 when infeasible); shortfall_j : what is missing (0 when feasible); charge_at_end : state of charge after the
    task, 0..1, below the reserve when infeasible and floored at 0 (empty before the end).
    """

    feasible: bool
    energy_j: float
    available_j: float
    margin_j: float
    shortfall_j: float
    charge_at_start: float
    charge_at_end: float
    reserve: float


def judge(energy_j: float, battery: Battery) -> Verdict:
    """The verdict for a task of `energy_j` [J]; negative where regeneration fills the battery."""
    margin = battery.available_j - energy_j
    at_end = battery.charge - energy_j / (battery.capacity_wh * 3600.0)
    return Verdict(
        feasible=margin >= 0.0,
        energy_j=energy_j,
        available_j=battery.available_j,
        margin_j=max(margin, 0.0),
        shortfall_j=max(-margin, 0.0),
        charge_at_start=battery.charge,
        charge_at_end=min(max(at_end, 0.0), 1.0),
        reserve=battery.reserve,
    )


def judge_along(pieces_j: ArrayLike, battery: Battery) -> Verdict:
    """The verdict for a task driven piece by piece. pieces_j : (n,) energy [J] of each, in order.

    The same as `judge` of the sum where no piece is negative. Where regeneration returns energy, what a full battery
    cannot take is lost, and the battery must last at its lowest point: margin and shortfall are counted there.
    """
    pieces = np.asarray(pieces_j, dtype=np.float64)
    verdict = judge(float(pieces.sum()), battery)
    if not (pieces < 0.0).any():
        return verdict
    room = (1.0 - battery.reserve) * battery.capacity_wh * 3600.0
    free = battery.available_j - np.append(0.0, np.cumsum(pieces))
    left = free - np.maximum.accumulate(np.maximum(free - room, 0.0))
    lowest = float(left.min())
    return replace(
        verdict,
        feasible=lowest >= 0.0,
        margin_j=max(lowest, 0.0),
        shortfall_j=max(-lowest, 0.0),
        charge_at_end=min(max(battery.reserve + float(left[-1]) / (battery.capacity_wh * 3600.0), 0.0), 1.0),
    )
