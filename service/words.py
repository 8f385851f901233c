"""Answers in plain words: what a route costs, what it saves, and whether the battery lasts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from joulemap.planner.budget import Verdict


def energy_words(energy_j: float) -> str:
    """Say an energy as a person reads it, with watt-hours from one kilojoule on.

    Parameters
    ----------
    energy_j : float
        Energy [J].

    Returns
    -------
    str
        Such as "12.30 kJ (3.42 Wh)".
    """
    if abs(energy_j) < 1000.0:
        return f"{energy_j:.0f} J"
    return f"{energy_j / 1000.0:.2f} kJ ({energy_j / 3600.0:.2f} Wh)"


def duration_words(seconds: float) -> str:
    """Say a duration in minutes and seconds, or hours and minutes.

    Parameters
    ----------
    seconds : float
        Duration [s].

    Returns
    -------
    str
        Such as "3 min 20 s".
    """
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def runs_words(count: int) -> str:
    """Say a number of runs.

    Parameters
    ----------
    count : int
        How many.

    Returns
    -------
    str
        "1 run", "2 runs".
    """
    return "1 run" if count == 1 else f"{count} runs"


def route_words(route: Mapping[str, Any]) -> str:
    """Say a route's length, energy and time.

    Parameters
    ----------
    route : mapping
        `energy_j`, `length_m`, and `duration_s` where it is known.

    Returns
    -------
    str
        Such as "146.2 m, 5.31 kJ (1.48 Wh), 4 min 52 s".
    """
    words = f"{route['length_m']:.1f} m, {energy_words(route['energy_j'])}"
    return f"{words}, {duration_words(route['duration_s'])}" if route.get("duration_s") is not None else words


def saving_words(route: Mapping[str, Any], shortest: Mapping[str, Any]) -> str:
    """Say what the energy-optimal route saves against the shortest, and by how much it is longer.

    Parameters
    ----------
    route, shortest : mapping
        `energy_j` and `length_m` of both.

    Returns
    -------
    str
        One sentence without a full stop.
    """
    saved = shortest["energy_j"] - route["energy_j"]
    longer = route["length_m"] - shortest["length_m"]
    if saved < 0.0005 * abs(shortest["energy_j"]):
        return "nothing: the shortest way is also the cheapest"
    share = f" ({saved / shortest['energy_j']:.1%})" if shortest["energy_j"] > 0 else ""
    detour = f", {longer:.1f} m longer" if longer >= 0.05 else ""
    return f"{energy_words(saved)} less than the shortest{share}{detour}"


def verdict_words(verdict: Verdict) -> str:
    """Say a verdict as a robot operator would.

    Parameters
    ----------
    verdict : Verdict
        Energies in J.

    Returns
    -------
    str
        One sentence without a full stop.
    """
    spread = "" if verdict.energy_std_j is None else f" +- {verdict.energy_std_j / 3600:.2f}"
    need = f"{verdict.energy_j / 3600:.2f}{spread} Wh needed, "
    need += f"{verdict.available_j / 3600:.2f} Wh available above the reserve"
    if verdict.probability is not None:
        need += f", lasts with {_probability_words(verdict.probability)}"
    if verdict.feasible:
        spare = f"{verdict.margin_j / 3600:.2f} Wh to spare"
        return f"feasible: {need}, {spare}; charge at the end {verdict.charge_at_end:.1%}"
    return f"not feasible: {need}, {verdict.shortfall_j / 3600:.2f} Wh short"


def _probability_words(probability: float) -> str:
    """A probability as far as it is worth saying: nobody knows the tails."""
    if probability > 0.99:
        return "more than 99 %"
    return "less than 1 %" if probability < 0.01 else f"{probability:.0%}".replace("%", " %")
