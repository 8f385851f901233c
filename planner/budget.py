"""Battery verdicts: will the energy last, and what is left?"""

from __future__ import annotations

from dataclasses import dataclass

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
    """The verdict for a task of `energy_j` [J]; energy may be negative where regeneration fills the battery up to full."""
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
