"""Energies and durations as a person reads them."""

from __future__ import annotations


def energy_words(energy_j: float) -> str:
    """Return an energy in words, with watt-hours beside it once they matter."""
    if abs(energy_j) < 1000.0:
        return f"{energy_j:.0f} J"
    return f"{energy_j / 1000.0:.2f} kJ ({energy_j / 3600.0:.2f} Wh)"


def range_words(energy_j: float, low_j: float, high_j: float) -> str:
    """Return an energy and the ends of its interval in one unit, for example "2.05 Wh, 1.80 to 2.30 Wh"."""
    size, unit, digits = (1.0, "J", 0) if max(abs(low_j), abs(high_j)) < 1000.0 else (3600.0, "Wh", 2)
    middle, low, high = (f"{value / size:.{digits}f}" for value in (energy_j, low_j, high_j))
    return f"{middle} {unit}, {low} to {high} {unit}"


def duration_words(seconds: float) -> str:
    """Return a duration in words. Result: minutes and seconds, or hours and minutes, for example "3 min 14 s"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def moved_words(metres: float) -> str:
    """Return how far a goal was moved, to be written after a route or a verdict; empty where it is less than 1 cm."""
    return f"; the goal was moved by {metres:.2f} m" if metres >= 0.01 else ""


def probability_words(probability: float) -> str:
    """Return a probability as far as it is worth saying: nobody knows the tails.

    Result: whole percent; beyond 1 and 99 % only that.
    """
    if probability >= 0.99:
        return "more than 99 %"
    return "less than 1 %" if probability <= 0.01 else f"{100.0 * probability:.0f} %"


def watt_words(power_w: float | None) -> str:
    """Return a power with its unit.

    `power_w`: power [W], None where it is not known. Result: whole watts from 100 W on, three digits below.
    """
    if power_w is None:
        return "unknown power"
    return f"{power_w:.0f} W" if abs(power_w) >= 100.0 else f"{power_w:.3g} W"
