"""Until where a robot may follow its path and still come home: the point of no return."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import isfinite
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from joulemap.model.ranges import MAX_CHARGING
from joulemap.service.questions.parts import BatteryIn, Confidence, OnMap, battery_of, on_map, unsure_notes
from joulemap.service.schemas.base import GivenPath, Place, PlaceOut, ResponseModel

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.homeward import Bail, Homeward


class ReturnRequest(OnMap):
    """Where the robot is, what is left of its path and its charge, and where home is."""

    position: Place = Field(examples=[[40.0, 30.0]])
    home: Place = Field(examples=[[12.5, 40.5]])
    path: GivenPath | None = Field(
        default=None,
        min_length=1,
        max_length=100_000,
        description="the rest of the path, world points [m], in order; without it, only whether it still comes home",
    )
    charging: list[Place] = Field(
        default=[], max_length=MAX_CHARGING, description="places to charge", examples=[[[60.0, 20.0]]]
    )
    battery: BatteryIn | None = Field(
        default=None, description="with the charge now; default: the robot's own, full, without a reserve"
    )
    confidence: Confidence = 0.95


class BailOut(ResponseModel):
    """Leaving the path for a place."""

    energy_j: float | None = Field(description="energy from here straight to the place [J]; null without a way")
    needed_j: float | None = Field(description="the same at the confidence [J]")
    probability: float | None = Field(description="that it lasts, 0.01..0.99; null where the model gives no odds")
    verdict: Literal["yes", "likely", "marginal", "no"] = Field(description="the same in a word")
    reachable: bool = Field(description="whether it lasts, at the confidence")
    way: list[list[float]] = Field(description="world [x, y] of the way from here [m]; empty without one")
    last: PlaceOut | None = Field(
        description="where the path must be left at the latest; null where it need not be left, or the place is out of "
        "reach already"
    )
    whole_path: bool = Field(description="whether the place can still be reached from the end of the path")
    cheapest: PlaceOut | None = Field(description="where the way from the path to the place takes least")
    cheapest_j: float | None = Field(description="energy of that way [J]")


class ReturnOut(ResponseModel):
    """Until where the robot may follow its path and still come home."""

    still_home: bool = Field(description="whether it still comes home from here, at the confidence")
    verdict: Literal["yes", "likely", "marginal", "no"] = Field(description="of coming home from here, by its odds")
    text: str = Field(description="the answer in one sentence")
    point_of_no_return: PlaceOut | None = Field(
        description="the last place of the path from which it comes home; null where that is its end, or home is out "
        "of reach already"
    )
    home: BailOut
    charging: list[BailOut] = Field(description="one for each place to charge, in the order asked for")
    best_charging: int | None = Field(
        description="number of the place whose way from the path takes least; null where none can be reached"
    )
    path_j: float = Field(description="energy of the rest of the path [J]")
    available_j: float = Field(description="energy above the reserve now [J]")
    length_m: float = Field(description="length of the rest of the path [m]")
    warnings: list[str]


def ask(planner: RoutePlanner, wanted: ReturnRequest) -> Homeward:
    """Find until where a robot may follow the rest of its path and still come home, or reach a place to charge."""
    from joulemap.service.analysis.homeward import homeward

    asked, unsure = on_map(planner, wanted), unsure_notes(planner.lattice, wanted)
    places = asked.places
    path = None if wanted.path is None else places.path(wanted.path)
    charging = [places(place, f"charging place {k}") for k, place in enumerate(wanted.charging, 1)]
    found = homeward(
        asked.planner,
        places(wanted.position, "position"),
        places(wanted.home, "home"),
        battery_of(wanted.battery, planner.lattice.robot),
        path=path,
        charging=charging,
        confidence=wanted.confidence,
    )
    ways = [found.home, *found.charging]
    if not any(np.isfinite(way.energy_j) for way in ways):
        raise asked.planner.no_way(places(wanted.position, "position"), places(wanted.home, "home"))
    return replace(found, notes=(*places.notes, *asked.planner.turning_notes, *unsure))


def is_quick(planner: RoutePlanner, wanted: ReturnRequest) -> bool:
    """Whether the ways towards home and the places to charge are kept, so that no search is needed."""
    from joulemap.service.places.places import Places

    places = Places(planner.lattice.frame)
    ends = [places(place, "place") for place in (wanted.home, *wanted.charging)]
    return not wanted.avoid and all(map(planner.keeps_ways_towards, ends))


def answer(found: Homeward, warnings: list[str]) -> ReturnOut:
    """As it is sent."""

    def _bail(bail: Bail) -> BailOut:
        known = {key: value for key, value in asdict(bail).items() if not isinstance(value, float) or isfinite(value)}
        return BailOut.model_validate(dict.fromkeys(BailOut.model_fields) | known | {"way": bail.way.tolist()})

    home = _bail(found.home)
    return ReturnOut(
        still_home=found.home.reachable,
        verdict=found.verdict,  # type: ignore[arg-type]
        text=str(found),
        point_of_no_return=home.last,
        home=home,
        charging=[_bail(bail) for bail in found.charging],
        best_charging=found.best_charging,
        path_j=found.path_j,
        available_j=found.available_j,
        length_m=found.length_m,
        warnings=[*found.notes, *warnings],
    )
