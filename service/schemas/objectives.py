"""What a route is chosen by, and how well it does by it: over HTTP and on the command line."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from joulemap.model.ranges import BATTERY, Range
from joulemap.service.objectives import OBJECTIVES, QUANTILES, Objective
from joulemap.service.schemas.base import Request, ResponseModel, within


class WeighedRequest(Request):
    """A question whose routes may be chosen by more than their expected energy."""

    objective: Literal[OBJECTIVES] = Field(  # type: ignore[valid-type]
        default="mean",
        description="what the best route is: least expected energy (mean), least energy at a quantile (quantile), or "
        "most likely to arrive with the reserve of the battery (arrival). The last two need a model that knows its "
        "uncertainty, and take a few searches instead of one",
    )
    quantile: Annotated[float, within(Range(*QUANTILES))] = Field(
        default=0.95,
        description="with the objective quantile: share of drives that take no more energy than what is made least",
    )
    max_power_w: Annotated[float, within(BATTERY["max_power_w"])] | None = Field(
        default=None,
        description="most power at the robot's speed [W]; where and in which headings driving takes more is blocked",
    )

    @property
    def chosen_by(self) -> Objective:
        """The objective that was asked for."""
        return Objective(self.objective, self.quantile)


class ObjectiveOut(ResponseModel):
    """How a route does by its objective, beside the route of least expected energy."""

    name: Literal["quantile", "arrival"] = Field(description="of the objective")
    quantile: float | None = Field(description="share of drives; null for arrival")
    quantile_j: float | None = Field(description="energy that this share of drives does not exceed [J]; null as above")
    mean_quantile_j: float | None = Field(
        description="the same on the route of least expected energy [J], never less; null as above"
    )
    probability: float | None = Field(description="that the battery lasts, with its tails; null for quantile")
    mean_probability: float | None = Field(
        description="the same on the route of least expected energy, never more; null as above"
    )
    gap: float | None = Field(
        description="by how much a better route may be better: as a share of the energy, or as a difference of "
        "probabilities, if every search found its cheapest route and the variance of a route is that of its metres; "
        "null where nothing is known"
    )
    searches: int = Field(ge=1, description="number of prices of uncertainty that were searched")
