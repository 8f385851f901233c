"""Whether a battery lasts for a path, or for the best route between two places."""

from __future__ import annotations

from pydantic import Field, model_validator

from joulemap.service.questions.parts import BatteryIn, WeighedRequest
from joulemap.service.schemas.base import GivenPath, Place


class FeasibilityRequest(WeighedRequest):
    """A task, either a path or start and goal, and a battery."""

    path: GivenPath | None = Field(
        default=None, min_length=2, max_length=100_000, description="world points [m], in order"
    )
    start: Place | None = Field(default=None, examples=[[12.5, 40.5]])
    goal: Place | None = Field(default=None, examples=[[80.0, 15.0]])
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place; a warning says where that is. A "
        "given path is never moved",
    )
    round_trip: bool = Field(
        default=False, description="also drive back: a given path in reverse, else the best way back"
    )
    battery: BatteryIn | None = Field(default=None, description="default: the robot's own, full, without a reserve")
    profile: bool = Field(default=False, description="also answer charge and voltage along the way")

    @model_validator(mode="after")
    def _one_task(self) -> FeasibilityRequest:
        ends = (self.start is not None) + (self.goal is not None)
        if (self.path is None and ends < 2) or (self.path is not None and ends > 0):
            raise ValueError("give either `path`, or `start` and `goal`")
        if self.path is not None and (self.objective != "mean" or self.max_power_w is not None):
            raise ValueError("`objective` and `max_power_w` choose a path: give `start` and `goal` in place of `path`")
        return self
