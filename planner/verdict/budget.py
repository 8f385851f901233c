"""Battery verdicts: whether the energy lasts, how likely that is, and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.battery import Battery, pack_of
from joulemap.planner.route import Route
from joulemap.planner.verdict.battery_trace import BatteryTrace, electric_available_j, trace_battery
from joulemap.planner.verdict.energy_distribution import QUANTILES, SURE, UNSEEN_SHARE, EnergyOdds, class_of
from joulemap.planner.verdict.trajectory import Course, Place, course_of
from joulemap.planner.verdict.words import verdict_in_words
from joulemap.planner.words import probability_words, watt_words

FloatArray = NDArray[np.float64]

PROBABILITY_LIMITS = (0.01, 0.99)
"""Beyond these no probability is given: the tails of the distribution of errors are not known."""


@dataclass(frozen=True, repr=False)
class Verdict:
    """Whether a battery lasts for a task.

    Attributes
    ----------
    feasible : bool
        Whether it lasts at the expected energy.
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
    energy_p05_j, energy_p50_j, energy_p95_j : float or None
        Energies that 5, 50 and 95 % of drives do not exceed [J]; None where the model gives no standard deviation.
    verdict : str
        "yes" (95 % likely to last, or more), "likely" (2/3), "marginal" (1/3) or "no". Without a standard deviation,
        with one of `odds.UNSEEN_SHARE` of the energy.
    verdict_text : str
        One sentence for an operator; empty where no course was given.
    charge_for_yes : float or None
        Least state of charge at the start for a "yes"; None where a full battery is not enough.
    yes_until_m : float or None
        Distance up to which it is a "yes" [m]; None where it is one to the end, or the course is not known.
    reserve_at : Place or None
        Where and when the reserve is touched, at the expected energy; None where it is not.
    overload_at : Place or None
        Where the power is first more than the battery can give, at the expected energy; None where it never is.
    overload_w, most_power_w : float or None
        The power there, and the most that the battery can give there [W].
    least_voltage_v : float or None
        Least voltage under load [V] up to the overload; None for a battery of which only energy is known.
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
    energy_p05_j: float | None = None
    energy_p50_j: float | None = None
    energy_p95_j: float | None = None
    verdict: str = ""
    verdict_text: str = ""
    charge_for_yes: float | None = None
    yes_until_m: float | None = None
    reserve_at: Place | None = None
    overload_at: Place | None = None
    overload_w: float | None = None
    most_power_w: float | None = None
    least_voltage_v: float | None = None

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
        if self.overload_at is not None:
            need += (
                f", and the {watt_words(self.overload_w)} at {self.overload_at.distance_m:.0f} m are more than the "
                f"{watt_words(self.most_power_w)} that the battery can give there"
            )
            if self.shortfall_j == 0.0:
                return f"not feasible: {need}"
        return f"not feasible: {need}, {self.shortfall_j / 3600:.2f} Wh short"


def judge(
    energy_j: ArrayLike, battery: Battery, *, std_j: ArrayLike | None = None, freedom: ArrayLike | None = None
) -> Verdict:
    """Return the verdict for a task of a given energy, or for one that is driven piece by piece.

    Parameters
    ----------
    energy_j : float or array_like, (n,)
        Energy of the task, or of each of its pieces in order [J]; negative where regeneration fills the battery.
    battery : Battery
        Capacity, charge and reserve. Its voltage is not judged: that needs a course.
    std_j : float or array_like, (n,), optional
        Standard deviation of the energy up to the end of each piece [J] of a normal distribution, or scale of Student's
        t.
    freedom : float or array_like, (n,), optional
        Degrees of freedom of Student's t.

    Returns
    -------
    Verdict
        Whether the battery lasts.

    Notes
    -----
    Where regeneration returns energy, what a full battery cannot take is lost, and the battery must last at its lowest
    point: margin and shortfall are counted there, and the probability is that of the piece after which the battery is
    most likely empty.
    """
    pieces = np.atleast_1d(np.asarray(energy_j, dtype=np.float64))
    known = None
    if std_j is not None:
        degrees = None if freedom is None else np.atleast_1d(np.asarray(freedom, dtype=np.float64))
        known = EnergyOdds(_summed(pieces), np.atleast_1d(np.asarray(std_j, dtype=np.float64)), degrees)
    return _judge(pieces, battery, known, battery.available_j).verdict


def judge_course(
    course: Course, battery: Battery, *, nominal_voltage_v: float, odds: EnergyOdds | None = None
) -> Verdict:
    """Return the verdict for a course, with where and why.

    Parameters
    ----------
    course : Course
        What is driven.
    battery : Battery
        Where more than energy is known of it, its losses and its voltage under load are judged too.
    nominal_voltage_v : float
        Of the robot [V], for a battery that does not say its own.
    odds : EnergyOdds, optional
        Of the energy from the start to the end of each piece; None where the model does not know its uncertainty.

    Returns
    -------
    Verdict
        With a sentence.

    Raises
    ------
    InputError
        If the battery's cut-off voltage is above every voltage that it has.
    """
    judged, trace = _judged_course(course, battery, nominal_voltage_v, odds)
    holds = _holds(course, trace, known=odds is not None)
    verdict = judged.verdict if trace is None else _under_load(judged, course, trace, holds, known=odds is not None)
    until = _yes_until_m(course, judged, holds)
    verdict = replace(verdict, reserve_at=_reserve_at(course, judged.left_j), yes_until_m=until)
    return replace(verdict, verdict_text=verdict_in_words(verdict, course))


def chance(course: Course, battery: Battery, *, nominal_voltage_v: float, odds: EnergyOdds | None) -> float:
    """Return the probability that a battery lasts for a course, with its tails: to compare courses by.

    Parameters
    ----------
    course, battery, nominal_voltage_v, odds : Course, Battery, float, EnergyOdds
        As for `judge_course`.

    Returns
    -------
    float
        Probability, 0 to 1.

    Raises
    ------
    InputError
        If the battery's cut-off voltage is above every voltage that it has.
    """
    judged, trace = _judged_course(course, battery, nominal_voltage_v, odds)
    return float(_holds(course, trace, known=odds is not None).min(initial=judged.lasts))


def _judged_course(
    course: Course, battery: Battery, nominal_voltage_v: float, odds: EnergyOdds | None
) -> tuple[_Judged, BatteryTrace | None]:
    """The verdict on the energy alone, and the battery along the course where more is known of it."""
    available, trace = battery.available_j, None
    if battery.is_electric:
        pack = pack_of(battery, nominal_voltage_v)
        trace = trace_battery(course, battery, pack)
        available = electric_available_j(battery, pack, trace, float(course.energy_j.sum()))
    return _judge(course.energy_j, battery, odds, available), trace


def battery_along(routes: Sequence[Route], battery: Battery, nominal_voltage_v: float) -> tuple[Course, BatteryTrace]:
    """Return a battery along routes that are driven one after another.

    Parameters
    ----------
    routes : sequence of Route
        In the order of driving, at least one.
    battery : Battery
        With a plain pack's values where it does not say its own.
    nominal_voltage_v : float
        Of the robot [V].

    Returns
    -------
    course : Course
        The pieces.
    trace : BatteryTrace
        The battery at each of them.

    Raises
    ------
    InputError
        If the battery's cut-off voltage is above every voltage that it has.
    """
    course = course_of(routes)
    return course, trace_battery(course, battery, pack_of(battery, nominal_voltage_v))


class _Judged(NamedTuple):
    """A verdict; what is left above the reserve at the start and after each piece, (n + 1,) [J]; what is missing for a
    yes after each piece, (n,) [J]; and the probability that the energy lasts.
    """

    verdict: Verdict
    left_j: FloatArray
    deficit_j: FloatArray
    lasts: float


def _judge(pieces: FloatArray, battery: Battery, known: EnergyOdds | None, available_j: float) -> _Judged:
    mean = _summed(pieces)
    left = available_j - np.append(0.0, mean)
    lowest = float(left[-1])
    if (pieces < 0.0).any():
        room = (1.0 - battery.reserve) * battery.full_j
        left = left - np.maximum.accumulate(np.maximum(left - room, 0.0))
        lowest = float(left.min())
    odds = known if known is not None else EnergyOdds(mean, UNSEEN_SHARE * np.abs(mean))
    lasts = float(odds.lasts(mean + left[1:]).min(initial=float(available_j >= 0.0)))
    deficit = odds.quantile(SURE) - mean - left[1:]
    charge = battery.charge + float(deficit.max(initial=-available_j)) / battery.full_j
    quantiles = [None] * len(QUANTILES) if known is None else [known.final_quantile(share) for share in QUANTILES]
    verdict = Verdict(
        feasible=lowest >= 0.0,
        energy_j=float(mean[-1]) if mean.size else 0.0,
        available_j=available_j,
        margin_j=max(lowest, 0.0),
        shortfall_j=max(-lowest, 0.0),
        charge_at_start=battery.charge,
        charge_at_end=min(max(battery.charge - (available_j - float(left[-1])) / battery.full_j, 0.0), 1.0),
        reserve=battery.reserve,
        energy_std_j=None if known is None else known.final_std_j,
        probability=None if known is None else _shown(lasts),
        energy_p05_j=quantiles[0],
        energy_p50_j=quantiles[1],
        energy_p95_j=quantiles[2],
        verdict=class_of(lasts),
        charge_for_yes=max(charge, 0.0) if charge <= 1.0 else None,
    )
    return _Judged(verdict, left, deficit, lasts)


def _summed(pieces: FloatArray) -> FloatArray:
    """Energy up to the end of each piece; the last is rounded as a sum is."""
    mean = np.cumsum(pieces)
    mean[-1:] = pieces.sum()
    return mean


def _shown(probability: float) -> float:
    return float(np.clip(probability, *PROBABILITY_LIMITS))


def _reserve_at(course: Course, left_j: FloatArray) -> Place | None:
    beyond = np.flatnonzero(left_j[1:] < 0.0)
    if beyond.size == 0:
        return None
    piece = int(beyond[0])
    before, after = left_j[piece : piece + 2].tolist()
    return course.place(piece, max(before, 0.0) / (max(before, 0.0) - after))


def _yes_until_m(course: Course, judged: _Judged, holds: FloatArray) -> float | None:
    unsure = np.flatnonzero((judged.deficit_j > 0.0) | (holds < SURE))
    if judged.left_j[0] < 0.0:
        return 0.0
    return None if unsure.size == 0 else float(np.append(0.0, course.distance_m)[unsure[0]])


def _holds(course: Course, trace: BatteryTrace | None, *, known: bool) -> FloatArray:
    """The probabilities that the power of each piece is no more than the battery can give, (n,)."""
    energy = course.energy_j
    if trace is None:
        return np.ones_like(energy)
    scale = course.std_j if known and course.std_j is not None else UNSEEN_SHARE * np.abs(energy)
    most = np.where(course.duration_s > 0.0, trace.most_power_w * course.duration_s, np.inf)
    return EnergyOdds(energy, scale).lasts(most)


def _under_load(judged: _Judged, course: Course, trace: BatteryTrace, holds: FloatArray, *, known: bool) -> Verdict:
    """The verdict with the voltage under load."""
    held, lasts = trace.voltage_v[: trace.overload], float(holds.min(initial=judged.lasts))
    verdict = replace(
        judged.verdict,
        charge_at_end=float(trace.charge[-1]) if trace.charge.size else judged.verdict.charge_at_end,
        least_voltage_v=float(held.min()) if held.size else None,
        verdict=class_of(lasts),
        probability=_shown(lasts) if known else None,
    )
    if (first := trace.overload) is None:
        return verdict
    return replace(
        verdict,
        feasible=False,
        charge_for_yes=None,
        overload_at=course.place(first, 0.0),
        overload_w=float(trace.power_w[first]),
        most_power_w=float(trace.most_power_w[first]),
    )
