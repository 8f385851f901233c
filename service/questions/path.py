"""Which way from one place to another."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from joulemap.model.ranges import SEARCH_S
from joulemap.planner.planners import PLANNERS
from joulemap.service.questions.parts import BatteryIn, WeighedRequest
from joulemap.service.schemas.base import Place, within


class PathRequest(WeighedRequest):
    """From where to where, and how to search."""

    start: Place = Field(examples=[[12.5, 40.5]])
    goal: Place = Field(examples=[[80.0, 15.0]])
    planner: Literal[PLANNERS] = Field(default="astar", description="the sampling planners use the whole time limit")  # type: ignore[valid-type]
    neighbours: Literal[8, 16, 32] = Field(
        default=16, description="moves per cell of the grid planners without `refine`; with it they are 32"
    )
    refine: bool = Field(default=True, description="shorten the grid path where it need not follow the grid")
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=5.0, description="how long the sampling planners search [s]"
    )
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="seed of the sampling planners")
    alternatives: int = Field(default=0, ge=0, le=10, description="most other good paths to look for")
    bound: bool = Field(
        default=False, description="search for a sharper `bound_j`, which takes some seconds once per cost map"
    )
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place; a warning says where that is",
    )
    battery: BatteryIn | None = Field(default=None, description="given: the answer says whether this battery lasts")
