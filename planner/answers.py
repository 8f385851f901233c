"""What a planner answers: a route between two places with what it was found beside, or a round trip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from joulemap.planner.route import Route
from joulemap.planner.words import energy_words


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The answer to one question.

    Attributes
    ----------
    route : Route
        Least energy found.
    shortest : Route
        Least length within the same limits, priced the same way.
    planner : str
        Name of the planner.
    details : dict
        JSON-able record of how the route was found: `seconds`, `expanded`, `grid_energy_j` [J] and more.
    others : tuple of Route
        Other good routes, cheapest first.
    bound_j : float or None
        Proven lower bound of the energy of every route between the two places, whatever its angles [J], see `bound`;
        None where nothing is known.
    """

    route: Route
    shortest: Route
    planner: str
    details: dict[str, Any]
    others: tuple[Route, ...] = ()
    bound_j: float | None = None

    @property
    def gap(self) -> float | None:
        """By which share of the bound the route may cost more than the best one; None without a bound above 0."""
        if self.bound_j is None or self.bound_j <= 0.0:
            return None
        return max(self.route.energy_j / self.bound_j - 1.0, 0.0)

    @property
    def saving_j(self) -> float:
        """Energy [J] that the route saves against the shortest path.

        0 where that is cheaper only because it is nearer to closed ground than the robot's margin.
        """
        return max(self.shortest.energy_j - self.route.energy_j, 0.0)

    def __repr__(self) -> str:
        return f"Plan({self.route.in_words()}; {energy_words(self.saving_j)} less than the shortest path)"

    def __str__(self) -> str:
        lines = [
            f"energy-optimal route ({self.planner}): {self.route.in_words()}",
            f"shortest path: {self.shortest.in_words()}",
            f"saving: {energy_words(self.saving_j)}",
            *(f"alternative {k}: {other.in_words()}" for k, other in enumerate(self.others, 1)),
            *(f"note: {note}" for note in self.route.notes),
        ]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False, repr=False)
class RoundTrip:
    """A tour of several stops.

    Attributes
    ----------
    legs : tuple of Route
        From each stop to the next, and from the last one home unless the tour is one way.
    order : tuple of int
        (n,) which stop is visited when, home (stop 0) first.
    grid_energy_j : float
        Energy of the tour over grid moves, without the turns at its stops [J].
    bound_j : float
        Proven lower bound of it over all orders of the stops that were asked for [J].
    notes : tuple of str
        Where stops were moved to, if any.
    """

    legs: tuple[Route, ...]
    order: tuple[int, ...]
    grid_energy_j: float
    bound_j: float
    notes: tuple[str, ...]

    @property
    def energy_j(self) -> float:
        """Energy [J] of all legs, with the turns at the stops between them."""
        return sum(leg.energy_j for leg in self.legs)

    @property
    def hops(self) -> list[tuple[int, int]]:
        """From which stop to which each leg leads."""
        return list(zip(self.order, (*self.order[1:], self.order[0]), strict=True))[: len(self.legs)]

    @property
    def proven(self) -> bool:
        """Whether no other order costs less over grid moves."""
        return self.grid_energy_j <= self.bound_j + 1e-6 * abs(self.bound_j) + 1e-3

    def __repr__(self) -> str:
        return f"RoundTrip({self._total()}, order {self._order()})"

    def __str__(self) -> str:
        legs = zip(self.hops, self.legs, strict=True)
        lines = [
            f"tour: {self._total()}",
            f"order: {self._order()}" + (", proven to be the best" if self.proven else ""),
            *(f"stop {here} to stop {there}: {leg.in_words()}" for (here, there), leg in legs),
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)

    def _total(self) -> str:
        length = sum(leg.length_m for leg in self.legs)
        return f"{len(self.order)} stops, {length:.1f} m, {energy_words(self.energy_j)}"

    def _order(self) -> str:
        return " - ".join(str(stop) for stop in (self.order[0], *(there for _, there in self.hops)))
