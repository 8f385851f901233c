"""Until where a robot may follow its path and still come home: the point of no return."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from joulemap.model.ranges import MAX_CHARGING, QUANTILE
from joulemap.service.questions.parts import BatteryIn, OnMap, battery_of, on_map
from joulemap.service.schemas.base import GivenPath, Place

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.homeward import Homeward
    from joulemap.service.questions.parts import AnyPlanner
    from joulemap.service.schemas.homeward import ReturnOut

CONFIDENCE = 0.95
"""Probability with which the battery must last, unless another is asked for."""


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
    confidence: float | None = Field(
        default=CONFIDENCE,
        ge=QUANTILE.low,
        le=QUANTILE.high,
        description="probability with which the battery must last; null where the expected energy decides",
    )


def ask(planner: AnyPlanner, wanted: ReturnRequest) -> Homeward:
    """Find until where a robot may follow the rest of its path and still come home, or reach a place to charge."""
    from joulemap.service.homeward import homeward

    asked = on_map(planner, wanted)
    places = asked.places
    path = None if wanted.path is None else places.path(wanted.path)
    charging = [places(place, f"charging place {k}") for k, place in enumerate(wanted.charging)]
    found = homeward(
        asked.planner,
        places(wanted.position, "position"),
        places(wanted.home, "home"),
        battery_of(wanted.battery, planner.lattice.robot),
        path=path,
        charging=charging,
        confidence=wanted.confidence,
    )
    return replace(found, notes=tuple(places.notes))


def is_quick(planner: RoutePlanner, wanted: ReturnRequest) -> bool:
    """Whether the energies towards home and the places to charge are kept, so that no search is needed."""
    from joulemap.service.places import Places

    places = Places(planner.lattice.frame)
    ends = [places(place, "place") for place in (wanted.home, *wanted.charging)]
    return not wanted.avoid and all(map(planner.keeps_energies_towards, ends))


def answer(found: Homeward, warnings: list[str]) -> ReturnOut:
    """As it is sent."""
    from joulemap.service.schemas.homeward import homeward_out

    return homeward_out(found, [*found.notes, *warnings])
