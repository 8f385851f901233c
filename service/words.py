"""Answers in plain words: what a route costs, what it saves, and whether the battery lasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from joulemap.model.runs.words import number_words
from joulemap.planner.words import duration_words, energy_words, moved_words

if TYPE_CHECKING:
    from joulemap.planner.verdict.budget import Verdict

__all__ = [
    "any_of",
    "capital",
    "duration_words",
    "energy_words",
    "objective_rows",
    "p_words",
    "percent",
    "route_words",
    "runs_words",
    "saving_words",
    "turning_words",
    "verdict_words",
]


def runs_words(count: int) -> str:
    """Say a number of runs."""
    return "1 run" if count == 1 else f"{count} runs"


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent."""
    return f"{100.0 * share:.{digits}f} %"


def any_of(names: Sequence[str]) -> str:
    """Join the names of things of which one is meant."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def capital(words: str) -> str:
    """Return words as the beginning of a sentence. `words`: may be empty. Result: with a first letter in upper case."""
    return words[:1].upper() + words[1:]


def p_words(p_value: float) -> str:
    """Return a p-value with its relation, to be written after "p".

    Result: such as "= 0.02", or "< 1e-9": smaller ones rest on the far tail of a distribution, which no data can check.
    """
    return "< 1e-9" if p_value < 1e-9 else f"= {p_value:.2g}"


def turning_words(trained: Mapping[str, Any]) -> str:
    """Say what turning costs by a model that was trained."""
    return f"{number_words(trained['turn_j_per_rad'])} J/rad more than straight driving, used in plans too"


def route_words(route: Mapping[str, Any]) -> str:
    """Say a route's length, energy and time. Result: such as "146.2 m, 5.31 kJ (1.48 Wh), 4 min 52 s"."""
    words = f"{route['length_m']:.1f} m, {energy_words(route['energy_j'])}"
    words += f", {duration_words(route['duration_s'])}" if route.get("duration_s") is not None else ""
    return words + moved_words(route.get("goal_moved_m", 0.0))


def saving_words(route: Mapping[str, Any], shortest: Mapping[str, Any]) -> str:
    """Say what the energy-optimal route saves against the shortest, and by how much it is longer.

    Result: one sentence without a full stop.
    """
    saved = shortest["energy_j"] - route["energy_j"]
    longer = route["length_m"] - shortest["length_m"]
    if saved < -0.0005 * abs(shortest["energy_j"]):  # chosen by something else
        return f"nothing: it takes {energy_words(-saved)} more than the shortest path"
    if saved < 0.0005 * abs(shortest["energy_j"]):
        return "nothing: the shortest way is also the cheapest"
    share = f" ({saved / shortest['energy_j']:.1%})" if shortest["energy_j"] > 0 else ""
    detour = f", {longer:.1f} m longer" if longer >= 0.05 else ""
    return f"{energy_words(saved)} less than the shortest{share}{detour}"


def objective_rows(weighed: Mapping[str, Any] | None) -> dict[str, str]:
    """Return how a route does by what it was chosen by, as a row of an answer.

    `weighed`: the fields of `Weighed`, None for the least expected energy. Result: None or one row.
    """
    if weighed is None:
        return {}
    if weighed["quantile_j"] is not None:
        most, usual = weighed["quantile_j"], weighed["mean_quantile_j"]
        less = f", {energy_words(usual - most)} less than on the cheapest path" if usual > most else ""
        return {"chosen by": f"{weighed['quantile']:.0%} of drives take at most {energy_words(most)}{less}"}
    likely, usual = weighed["probability"], weighed["mean_probability"]
    return {"chosen by": f"{likely:.1%} likely to arrive with the reserve, {usual:.1%} on the cheapest path"}


def verdict_words(verdict: Verdict) -> str:
    """Say a verdict as a robot operator would. Result: one sentence without a full stop."""
    return str(verdict)
