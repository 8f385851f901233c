"""The point of no return of a robot on its way: the question and its answer."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Annotated, Literal

from pydantic import Field, WrapValidator

from joulemap.planner.verdict.point_of_no_return import Bail
from joulemap.service.homeward import CONFIDENCE, MOST_CHARGING, Homeward
from joulemap.service.schemas.base import Areas, PathPlace, Place, Request, ResponseModel, RobotIn, quick_points
from joulemap.service.schemas.planning import BatteryIn, PlaceOut


class ReturnRequest(Request):
    """Where the robot is, what is left of its path and its charge, and where home is."""

    position: Place = Field(examples=[[40.0, 30.0]])
    home: Place = Field(examples=[[12.5, 40.5]])
    path: Annotated[list[PathPlace], Field(fail_fast=True), WrapValidator(quick_points)] | None = Field(
        default=None,
        min_length=1,
        max_length=100_000,
        description="the rest of the path, world points [m], in order; without it, only whether it still comes home",
    )
    charging: list[Place] = Field(
        default=[], max_length=MOST_CHARGING, description="places to charge", examples=[[[60.0, 20.0]]]
    )
    battery: BatteryIn | None = Field(
        default=None, description="with the charge now; default: the robot's own, full, without a reserve"
    )
    confidence: float | None = Field(
        default=CONFIDENCE,
        ge=0.5,
        le=0.99,
        description="probability with which the battery must last; null where the expected energy decides",
    )
    avoid: Areas = Field(default=[])
    robot: RobotIn | None = Field(default=None, description="refused where it differs from the cost map's robot")


class BailOut(ResponseModel):
    """Leaving the path for a place."""

    energy_j: float | None = Field(description="energy from here straight to the place [J]; null without a way")
    needed_j: float | None = Field(description="the same at the confidence [J]")
    probability: float | None = Field(description="that the battery lasts for it; null where the model gives no odds")
    reachable: bool = Field(description="whether it lasts, at the confidence")
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


def homeward_out(found: Homeward, warnings: list[str]) -> ReturnOut:
    """Return the answer to the question for the point of no return.

    Parameters
    ----------
    found : Homeward
        What was found.
    warnings : list of str
        Of the cost map.

    Returns
    -------
    ReturnOut
        As it is sent.
    """
    home = _bail_out(found.home)
    return ReturnOut(
        still_home=found.home.reachable,
        verdict=found.verdict,  # type: ignore[arg-type]
        text=str(found),
        point_of_no_return=home.last,
        home=home,
        charging=[_bail_out(bail) for bail in found.charging],
        best_charging=found.best_charging,
        path_j=found.path_j,
        available_j=found.available_j,
        length_m=found.length_m,
        warnings=warnings,
    )


def _bail_out(bail: Bail) -> BailOut:
    values = {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in asdict(bail).items()
    }
    return BailOut.model_validate(values)
