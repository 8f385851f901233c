"""What a route costs at other speeds."""

from __future__ import annotations

from pydantic import Field, model_validator

from joulemap.service.questions.parts import OnMap
from joulemap.service.schemas.base import GivenPath, Place


class SpeedsRequest(OnMap):
    """A route: either a path, or start and goal."""

    path: GivenPath | None = Field(
        default=None, min_length=2, max_length=5_000, description="world points [m], in order"
    )
    start: Place | None = Field(default=None, examples=[[12.5, 40.5]])
    goal: Place | None = Field(default=None, examples=[[80.0, 15.0]])
    snap: bool = Field(default=False, description="move a start or goal on blocked ground to the nearest free place")

    @model_validator(mode="after")
    def _one_task(self) -> SpeedsRequest:
        ends = (self.start is not None) + (self.goal is not None)
        if (self.path is None and ends < 2) or (self.path is not None and ends > 0):
            raise ValueError("give either `path`, or `start` and `goal`")
        return self
