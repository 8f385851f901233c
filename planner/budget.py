"""Battery verdicts: will the energy last, and what is left?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from joulemap.model.robot import Battery


@dataclass(frozen=True)
class Verdict:
    """Whether a battery lasts for a task.

    energy_j : energy the task asks for; available_j : energy above the reserve at the start; margin_j : what is left of
    it (0 when infeasible); shortfall_j : what is missing (0 when feasible); charge_at_end : state of charge after the
    task, 0..1, below the reserve when infeasible and floored at 0 (empty before the end). energy_std_j : standard
    deviation of energy_j, and probability, 0..1, that the battery lasts; None where nobody knows how far off it may be.
    """

    feasible: bool
    energy_j: float
    available_j: float
    margin_j: float
    shortfall_j: float
    charge_at_start: float
    charge_at_end: float
    reserve: float
    energy_std_j: float | None = None
    probability: float | None = None


def judge(energy_j: float, battery: Battery, *, std_j: float | None = None) -> Verdict:
    """The verdict for a task of `energy_j` [J], negative where regeneration fills the battery. std_j : its standard
    deviation [J], of a normal distribution.
    """
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
        energy_std_j=std_j,
        probability=None if std_j is None else float(_probability(margin, std_j)),
    )


def judge_along(pieces_j: ArrayLike, battery: Battery, *, std_j: ArrayLike | None = None) -> Verdict:
    """The verdict for a task driven piece by piece. pieces_j : (n,) energy [J] of each, in order; std_j : (n,) standard
    deviation [J] of the energy up to the end of each.

    The same as `judge` of the sum where no piece is negative. Where regeneration returns energy, what a full battery
    cannot take is lost, and the battery must last at its lowest point: margin and shortfall are counted there, and the
    probability is that of the piece after which the battery is likeliest empty.
    """
    pieces = np.asarray(pieces_j, dtype=np.float64)
    std = None if std_j is None else np.append(0.0, std_j)
    verdict = judge(float(pieces.sum()), battery, std_j=None if std is None else float(std[-1]))
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
        probability=None if std is None else float(_probability(left, std).min()),
    )


def _probability(margin_j: ArrayLike, std_j: ArrayLike) -> NDArray[np.float64]:
    """That normal variables of these means and standard deviations are not negative."""
    margin, std = np.asarray(margin_j, dtype=np.float64), np.asarray(std_j, dtype=np.float64)
    return np.where(std > 0.0, ndtr(margin / np.where(std > 0.0, std, 1.0)), margin >= 0.0)
