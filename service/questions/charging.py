"""Which way, charging where it may: the cheapest one that never falls below the reserve."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from joulemap.model.ranges import MAX_CHARGING
from joulemap.service.questions.parts import UNSURE, Confidence, OnMap, OwnBattery, Snap, battery_of, on_map
from joulemap.service.schemas.base import Place, Point3, ResponseModel
from joulemap.service.words import duration_words, energy_words

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.model.battery import Battery
    from joulemap.planner.questions.charging import Hop
    from joulemap.planner.route import Route
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.planner.verdict.budget import Verdict


_ROUNDING = 1e-9
"""Share that is charged beside what a way needs, so that rounding does not leave it short."""


class ChargingRequest(OnMap):
    """From where to where, and where and how the battery is charged."""

    start: Place = Field(examples=[[12.5, 40.5]])
    goal: Place = Field(examples=[[80.0, 15.0]])
    at: list[Place] = Field(
        min_length=1,
        max_length=MAX_CHARGING,
        description="places to charge, world points [m]",
        examples=[[[40.0, 30.0]]],
    )
    power_w: float | None = Field(
        default=None, ge=1.0, le=1e6, description="power into the battery while it is charged [W]", examples=[150.0]
    )
    swap_s: float | None = Field(
        default=None, ge=0.0, le=1e5, description="instead: time in which the battery is swapped for a full one [s]"
    )
    stop_s: float = Field(default=60.0, ge=0.0, le=1e5, description="time that a stop takes beside charging [s]")
    least: Literal["energy", "time"] = Field(
        default="energy", description="whether energy is least, or the time of driving, stopping and charging"
    )
    battery: OwnBattery = None
    confidence: Confidence = 0.95
    snap: Snap = False

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.power_w is None) == (self.swap_s is None):
            raise ValueError("give either `power_w` or `swap_s`")
        return self


class ChargedLegOut(ResponseModel):
    """The way to a place to charge, or to the goal."""

    charger: int | None = Field(description="number of the place in `at` at which it begins; null for the start")
    charged_j: float = Field(description="energy that is charged before it [J]")
    waits_s: float = Field(description="how long that takes, the stop included [s]")
    charge_at_start: float = Field(description="state of charge with which it begins, 0..1")
    charge_at_end: float = Field(description="expected state of charge at its end, 0..1")
    probability: float | None = Field(description="that the battery lasts for it; null where the model gives no odds")
    energy_j: float = Field(description="expected energy [J]")
    length_m: float = Field(description="horizontal length [m]")
    duration_s: float = Field(description="driving time [s]")
    path: list[Point3] = Field(repr=False)


class ChargingOut(ResponseModel):
    """The cheapest way that never falls below the reserve."""

    feasible: bool = Field(description="whether there is such a way")
    text: str = Field(description="the answer in one sentence")
    energy_j: float | None = Field(description="expected energy of driving [J]; null where there is no such way")
    duration_s: float | None = Field(description="time of driving, stopping and charging [s]; likewise")
    legs: list[ChargedLegOut] = Field(description="in the order of driving; empty where there is no such way")
    warnings: list[str]
    crs: str | None


@dataclass(frozen=True, eq=False)
class ChargedLeg:
    """The way to a place to charge, or to the goal, and whether the battery lasts for it."""

    hop: Hop
    route: Route
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class ChargedWay:
    """The cheapest way over places to charge.

    Attributes
    ----------
    legs : tuple of ChargedLeg
        In the order of driving; empty where no chain of places reaches the goal.
    why_not : str
        Why there is no such way.
    notes : tuple of str
        Where places were moved to, and how they were read.
    crs : str or None
        Coordinate reference system of the map.
    """

    legs: tuple[ChargedLeg, ...]
    why_not: str
    notes: tuple[str, ...]
    crs: str | None

    @property
    def energy_j(self) -> float:
        """Expected energy of driving [J]."""
        return sum(leg.route.energy_j for leg in self.legs)

    @property
    def duration_s(self) -> float:
        """Time of driving, stopping and charging [s]."""
        return sum(leg.route.duration_s + leg.hop.waits_s for leg in self.legs)

    def __str__(self) -> str:
        if not self.legs:
            return self.why_not
        stops = [leg.hop.start for leg in self.legs if leg.hop.charged_j > 0.0]
        where = f"charging at {', '.join(f'place {k}' for k in stops)}" if stops else "without charging"
        return f"It arrives {where}: {energy_words(self.energy_j)}, {duration_words(self.duration_s)}."


def ask(
    planner: RoutePlanner, wanted: ChargingRequest, *, progress: Callable[[float], None] | None = None
) -> ChargedWay:
    """Find the cheapest way, by fields between all places and the routes of the ways that are best so far.

    The energies between places are those over grid moves at first. The ways of the best chain are planned and priced as
    any route is, and the search is repeated with what they really need, until it chooses planned ways only.
    """
    from joulemap.planner.questions.charging import Charging, cheapest_chain
    from joulemap.planner.route_planner import RouteOptions
    from joulemap.service.analysis.feasibility import judge_routes
    from joulemap.service.analysis.route_uncertainty import odds_along

    planner.needs_memory("a way over charging places")
    asked = on_map(planner, wanted)
    lattice, battery = asked.planner.lattice, battery_of(wanted.battery, planner.lattice.robot)
    named = [("start", wanted.start), *((f"charging place {k}", one) for k, one in enumerate(wanted.at, 1))]
    places = [asked.places(place, name) for name, place in [*named, ("goal", wanted.goal)]]
    found, notes = asked.planner.matrix(places, places, snap=wanted.snap, progress=progress)
    energy, seconds = found.energies_j.copy(), found.lengths_m / lattice.robot.speed_mps
    need, routes = energy.copy(), dict[tuple[int, int], Any]()
    room = (1.0 - battery.reserve) * battery.full_j
    how = Charging(wanted.power_w, wanted.stop_s if wanted.swap_s is None else wanted.swap_s)
    while True:
        chain = cheapest_chain(
            energy,
            need,
            seconds,
            how,
            available_j=battery.available_j,
            full_j=room,
            quickest=wanted.least == "time",
        )
        new = [ends for hop in chain or [] if (ends := (hop.start, hop.goal)) not in routes]
        if not new:
            break
        for ends in new:
            route = routes[ends] = asked.planner.plan(*(places[k] for k in ends), RouteOptions(snap=wanted.snap)).route
            energy[ends], seconds[ends], odds = route.energy_j, route.duration_s, odds_along([route])
            sure = None if odds is None or wanted.confidence is None else odds.quantile(wanted.confidence)
            least_j = max(route.energy_j if sure is None else float(sure.max(initial=0.0)), 0.0)
            need[ends] = least_j * (1.0 + _ROUNDING)
    if wanted.confidence is not None and lattice.std_j is None:
        notes = [*notes, UNSURE]
    notes = tuple(dict.fromkeys([*asked.places.notes, *notes]))

    def _leg(hop: Hop) -> ChargedLeg:
        route = routes[hop.start, hop.goal]
        begins = replace(battery, charge=min(battery.reserve + hop.left_j / battery.full_j, 1.0))
        return ChargedLeg(hop, route, judge_routes(lattice, [route], begins))

    if chain is None and not np.isfinite(energy[:-1, -1]).any():
        raise asked.planner.no_way(places[0], places[-1], snap=wanted.snap)
    why = "" if chain is not None else _why_not(energy, battery, room)
    return ChargedWay(tuple(map(_leg, chain or [])), why, notes, lattice.frame.crs)


def _why_not(energy: np.ndarray, battery: Battery, room: float) -> str:
    """Which charge the best chain would need of every place."""
    nearest, into = float(energy[0, 1:].min()), float(energy[1:-1, -1].min())
    return (
        f"No chain of charging places reaches the goal: the start has {energy_words(battery.available_j)} above the "
        f"reserve, and the nearest place takes {energy_words(nearest)}; a full battery has {energy_words(room)}, and "
        f"the goal takes {energy_words(into)} from the nearest place to charge."
    )


def answer(found: ChargedWay, warnings: list[str]) -> ChargingOut:
    """As it is sent."""
    from joulemap.service.schemas.planning import path_points

    legs = [
        ChargedLegOut(
            charger=None if leg.hop.start == 0 else leg.hop.start - 1,
            charged_j=leg.hop.charged_j,
            waits_s=leg.hop.waits_s,
            charge_at_start=leg.verdict.charge_at_start,
            charge_at_end=leg.verdict.charge_at_end,
            probability=leg.verdict.probability,
            energy_j=leg.route.energy_j,
            length_m=leg.route.length_m,
            duration_s=leg.route.duration_s,
            path=path_points(leg.route),
        )
        for leg in found.legs
    ]
    return ChargingOut(
        feasible=bool(legs),
        text=str(found),
        energy_j=found.energy_j if legs else None,
        duration_s=found.duration_s if legs else None,
        legs=legs,
        warnings=[*found.notes, *warnings],
        crs=found.crs,
    )
