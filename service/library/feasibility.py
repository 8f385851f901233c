"""Whether the battery lasts, as a Python user has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.planner.route import Route
from joulemap.planner.verdict.budget import Verdict, battery_along
from joulemap.service.library.planned import route_numbers
from joulemap.service.library.shown import Shown
from joulemap.service.words import duration_words, route_words, verdict_words

if TYPE_CHECKING:
    from joulemap.model.battery import Battery
    from joulemap.planner.verdict.battery_trace import BatteryTrace
    from joulemap.planner.verdict.trajectory import Course


@dataclass(frozen=True, eq=False, repr=False)
class Feasibility(Shown):
    """Whether the battery lasts for a task. It is true in a condition exactly when it does.

    Attributes
    ----------
    verdict : Verdict
        Energy, margin and charge at the end.
    route_out : Route
        The way there.
    route_back : Route or None
        The way back of a round trip.
    warnings : tuple of str
        Where map or robot lie outside what the model learned.
    battery : Battery or None
        That was judged; None for a tour.
    nominal_voltage_v : float
        Of the robot [V].
    """

    verdict: Verdict
    route_out: Route
    route_back: Route | None = None
    warnings: tuple[str, ...] = ()
    battery: Battery | None = None
    nominal_voltage_v: float = Robot.nominal_voltage_v

    @property
    def feasible(self) -> bool:
        """Whether the battery lasts, with its reserve."""
        return self.verdict.feasible

    @property
    def energy_j(self) -> float:
        """Energy that the task takes [J]."""
        return self.verdict.energy_j

    @property
    def margin_j(self) -> float:
        """Energy that is left above the reserve [J]; 0 when it does not last."""
        return self.verdict.margin_j

    @property
    def shortfall_j(self) -> float:
        """Energy that is missing [J]; 0 when it lasts."""
        return self.verdict.shortfall_j

    @property
    def charge_at_end(self) -> float:
        """State of charge after the task, 0..1."""
        return self.verdict.charge_at_end

    @property
    def class_(self) -> str:
        """One of "yes" (95 % likely, or more), "likely" (2/3), "marginal" (1/3) and "no"."""
        return self.verdict.verdict

    @property
    def text(self) -> str:
        """The verdict in one sentence, with what would make it a yes."""
        return self.verdict.verdict_text

    def battery_along(self) -> tuple[Course, BatteryTrace]:
        """Return the battery piece by piece, with a plain pack's values where nothing else is known.

        Returns
        -------
        course : Course
            The pieces of the way, with distance [m], time [s] and energy [J].
        trace : BatteryTrace
            State of charge, voltage [V] and power [W] of each.

        Raises
        ------
        InputError
            If the task is a tour, or the cut-off voltage is above every voltage that the battery has.
        """
        if self.battery is None:
            raise InputError("a tour has no trace of the battery: ask for one of its legs")
        routes = [route for route in (self.route_out, self.route_back) if route is not None]
        return battery_along(routes, self.battery, self.nominal_voltage_v)

    @property
    def probability(self) -> float | None:
        """Probability that the battery lasts, 0.01..0.99; None where the model does not know its own uncertainty."""
        return self.verdict.probability

    def __bool__(self) -> bool:
        return self.verdict.feasible

    def __repr__(self) -> str:
        return f"<Feasibility: {verdict_words(self.verdict)}>"

    def __str__(self) -> str:
        return "\n".join([verdict_words(self.verdict), self.text, *(f"Warning: {words}" for words in self.warnings)])

    def _title(self) -> str:
        return verdict_words(self.verdict)

    def _rows(self) -> dict[str, str]:
        routes = {"way out": self.route_out, "way back": self.route_back}
        rows = {name: route_words(route_numbers(route)) for name, route in routes.items() if route is not None}
        rows["time"] = duration_words(sum(r.duration_s for r in routes.values() if r is not None))
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})
