"""Several places and home again, in the order that takes least energy."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from joulemap.model.ranges import MOST_STOPS, SEARCH_S
from joulemap.service.questions.parts import BatteryIn, OnMap
from joulemap.service.schemas.base import Place, within


class TourRequest(OnMap):
    """Places to visit, and how to search. The service finds the order."""

    stops: list[Place] = Field(
        min_length=2,
        max_length=MOST_STOPS,
        description="places to visit, world [x, y] [m]; the first is where the tour begins and ends",
        examples=[[[12.5, 40.5], [80.0, 15.0], [60.0, 50.0]]],
    )
    neighbours: Literal[8, 16, 32] = Field(default=16, description="moves per cell of the search")
    refine: bool = Field(default=True, description="shorten the legs where they need not follow the grid")
    snap: bool = Field(
        default=False, description="move stops on blocked ground to the nearest free place; warnings say where that is"
    )
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=10.0, description="longest time for proving that the order is the best one [s]"
    )
    battery: BatteryIn | None = Field(
        default=None, description="given: the answer says whether this battery lasts for the whole tour"
    )
