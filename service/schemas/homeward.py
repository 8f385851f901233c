"""The point of no return of a robot on its way: the question and its answer."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Literal

from pydantic import Field

from joulemap.planner.verdict.point_of_no_return import Bail
from joulemap.service.homeward import Homeward
from joulemap.service.schemas.base import ResponseModel
from joulemap.service.schemas.planning import PlaceOut


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
