"""Battery verdicts: whether the energy lasts, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.robot import Battery
from joulemap.planner.words import probability_words

PROBABILITY_LIMITS = (0.01, 0.99)
"""Beyond these no probability is given: the tails of the distribution of errors are not known."""


@dataclass(frozen=True, repr=False)
class Verdict:
    """Whether a battery lasts for a task.

    Attributes
    ----------
    feasible : bool
        Whether it lasts.
    energy_j : float
        Energy that the task needs [J].
    available_j : float
        Energy above the reserve at the start [J].
    margin_j : float
        What is left of it [J]; 0 when infeasible.
    shortfall_j : float
        What is missing [J]; 0 when feasible.
    charge_at_start : float
        State of charge before the task, 0..1.
    charge_at_end : float
        State of charge after the task, 0..1: below the reserve when infeasible, 0 when empty before the end.
    reserve : float
        Share of the capacity that must remain, 0..1.
    energy_std_j : float or None
        Standard deviation of `energy_j` [J]; None where the model gives none.
    probability : float or None
        That the battery lasts, 0.01..0.99: 0.99 means at least 0.99, and 0.01 at most 0.01. None where the model gives
        no standard deviation.
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

    def __repr__(self) -> str:
        return f"Verdict({self})"

    def __str__(self) -> str:
        spread = "" if self.energy_std_j is None else f" +- {self.energy_std_j / 3600:.2f}"
        need = f"{self.energy_j / 3600:.2f}{spread} Wh needed, "
        need += f"{self.available_j / 3600:.2f} Wh available above the reserve"
        if self.probability is not None:
            need += f", probability that it lasts: {probability_words(self.probability)}"
        if self.feasible:
            spare = f"{self.margin_j / 3600:.2f} Wh to spare"
            return f"feasible: {need}, {spare}; charge at the end {self.charge_at_end:.1%}"
        return f"not feasible: {need}, {self.shortfall_j / 3600:.2f} Wh short"


def judge(energy_j: float, battery: Battery, *, std_j: float | None = None) -> Verdict:
    """Return the verdict for a task of a given energy.

    Parameters
    ----------
    energy_j : float
        Energy that the task needs [J]; negative where regeneration fills the battery.
    battery : Battery
        Capacity, charge and reserve.
    std_j : float, optional
        Standard deviation of `energy_j` [J], of a normal distribution.

    Returns
    -------
    Verdict
        Whether the battery lasts.
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
    """Return the verdict for a task driven piece by piece.

    Parameters
    ----------
    pieces_j : array_like, (n,)
        Energy of each piece, in order [J].
    battery : Battery
        Capacity, charge and reserve.
    std_j : array_like, (n,), optional
        Standard deviation of the energy up to the end of each piece [J].

    Returns
    -------
    Verdict
        Whether the battery lasts.

    Notes
    -----
    The same as `judge` of the sum where no piece is negative. Where regeneration returns energy, what a full battery
    cannot take is lost, and the battery must last at its lowest point: margin and shortfall are counted there, and the
    probability is that of the piece after which the battery is most likely empty.
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
    """That normal variables of these means and standard deviations are not negative, within `PROBABILITY_LIMITS`."""
    margin, std = np.asarray(margin_j, dtype=np.float64), np.asarray(std_j, dtype=np.float64)
    from scipy.special import ndtr  # loads slowly, and few questions need it

    lasts = np.where(std > 0.0, ndtr(margin / np.where(std > 0.0, std, 1.0)), margin >= 0.0)
    return np.clip(lasts, *PROBABILITY_LIMITS)
