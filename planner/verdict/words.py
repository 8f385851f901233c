"""A verdict in one sentence: how likely, what it takes, where most of it goes, and what would make it a yes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from joulemap.planner.verdict.trajectory import Course, Stretch
from joulemap.planner.words import probability_words, watt_words

if TYPE_CHECKING:
    from joulemap.planner.verdict.budget import Verdict

_LIFTED = 0.5  # share of the energy of a stretch that lifts the robot, from which it is a climb


def verdict_in_words(verdict: Verdict, course: Course) -> str:
    """Return a verdict as a sentence.

    Result: such as "Likely: 78 % to return with the reserve; expected 6.58 Wh (90 % between 5.28 and 7.89 Wh) of 8.61
    Wh above the reserve; the climb that begins 210 m along the way out and ends at 260 m takes 51 % of the energy; a
    charge of 71 % makes it a yes.".
    """
    parts = [_odds(verdict, course), _energy(verdict)]
    if verdict.overload_at is not None:
        parts.append(
            f"the {watt_words(verdict.overload_w)} at {verdict.overload_at.distance_m:.0f} m are more than the "
            f"{watt_words(verdict.most_power_w)} that the battery can give there"
        )
    if (stretch := course.dearest()) is not None:
        parts.append(_stretch(stretch, course, verdict.energy_j))
    if verdict.verdict != "yes":
        parts.append(_advice(verdict))
    return "; ".join(part for part in parts if part) + "."


def _odds(verdict: Verdict, course: Course) -> str:
    word = verdict.verdict.capitalize()
    if verdict.probability is None:
        return f"{word}, without odds because the model has seen no runs"
    task = "return" if course.returns else "arrive"
    task += " with the reserve" if verdict.reserve > 0.0 else ""
    return f"{word}: {probability_words(verdict.probability)} to {task}"


def _energy(verdict: Verdict) -> str:
    between = ""
    if verdict.energy_p05_j is not None and verdict.energy_p95_j is not None:
        between = f" (90 % between {_wh(verdict.energy_p05_j)} and {_wh(verdict.energy_p95_j)} Wh)"
    words = f"expected {_wh(verdict.energy_j)} Wh{between}"
    if verdict.available_j < 0.0:
        return f"{words}, and the charge is below the reserve already"
    return f"{words} of {_wh(verdict.available_j)} Wh{' above the reserve' if verdict.reserve > 0.0 else ''}"


def _wh(energy_j: float) -> str:
    """As batteries are labelled: three digits, and never a power of ten."""
    energy_wh = energy_j / 3600.0
    digits = 2 - math.floor(math.log10(max(abs(energy_wh), 1e-2)))
    return f"{energy_wh:.{max(digits, 0)}f}"


def _stretch(stretch: Stretch, course: Course, energy_j: float) -> str:
    lift_j = math.nan if course.weight_n is None else course.weight_n * stretch.rise_m
    what = "climb" if lift_j >= _LIFTED * stretch.share * energy_j else "stretch"  # NaN: unknown, so a stretch
    ways = {1: ("the route",), 2: ("the way out", "the way back") if course.returns else None}.get(course.ways)
    way = ways[stretch.way] if ways else f"leg {stretch.way + 1}"
    where = (
        f"on the first {stretch.end_m:.0f} m of {way}"
        if stretch.start_m < 0.5
        else f"that begins {stretch.start_m:.0f} m along {way} and ends at {stretch.end_m:.0f} m"
    )
    return f"the {what} {where} takes {100.0 * stretch.share:.0f} % of the energy"


def _advice(verdict: Verdict) -> str:
    """What would make it a yes."""
    if verdict.overload_at is not None:
        return "a battery that gives more power, or a way around it (a limit of power finds one), is needed"
    if verdict.charge_for_yes is not None:
        if verdict.charge_for_yes > verdict.charge_at_start:
            return f"a charge of {math.ceil(100 * verdict.charge_for_yes - 1e-9)} % makes it a yes"
        return "its peaks of power are close to the most that the battery can give"
    words = "even a full battery does not make it a yes"
    if verdict.yes_until_m:
        words += f", but the first {math.floor(verdict.yes_until_m)} m are one"
    return words
