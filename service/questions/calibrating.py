"""How runs are compared with a model: what every face asks for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import AliasChoices, Field, model_validator

from joulemap.model.ranges import TRACK_M
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.questions.training import ModelPlace
from joulemap.service.schemas.base import Place, Request, RobotIn, within

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.model.runs.calibration_runs import CalibrationRuns
    from joulemap.service.loop.calibration import Calibrated


class CalibrationOptions(Request):
    """What is compared, and how errors are found."""

    start: Place | None = Field(
        default=None, description="start of the route that is compared before and after; default: a few pairs are tried"
    )
    goal: Place | None = Field(default=None, description="its goal")
    campaigns: bool = Field(
        default=False,
        description="for the errors, leave out whole campaigns instead of single runs; runs of one campaign have the "
        "same date in their name, or the same name before the last underscore (2018-11_00 and 2018-11_01)",
    )
    quick: bool = Field(
        default=False,
        description="calibrate once, without repeating everything on parts of the runs: the errors are then those of "
        "the fit, which are too small",
    )
    seed: int = Field(
        default=0,
        ge=0,
        le=2**31 - 1,
        description="seed of the places that are tried for the route and the next drive",
    )

    @model_validator(mode="after")
    def _whole_task(self) -> Self:
        if (self.start is None) != (self.goal is None):
            raise ValueError("give both `start` and `goal`, or neither")
        return self


class CalibrationRequest(CalibrationOptions):
    """Which runs to compare with which model."""

    heightmap_id: str | None = Field(
        default=None,
        max_length=100,
        description="heightmap that the runs were driven on; leave it out for runs without positions",
        examples=["hm-5f0c2a9d41be"],
    )
    runs: list[Annotated[str, Field(max_length=100)]] = Field(
        min_length=1, max_length=100, description="ids of the runs to learn from", examples=[["runs-3b9d0c1e77aa"]]
    )
    baseline_runs: list[Annotated[str, Field(max_length=100)]] = Field(
        default=[],
        max_length=100,
        validation_alias=AliasChoices("baseline_runs", "base_runs"),
        description="ids of earlier runs, without what is looked for; default: those the model keeps of its training",
    )
    test_runs: list[Annotated[str, Field(max_length=100)]] = Field(
        default=[],
        max_length=100,
        validation_alias=AliasChoices("test_runs", "aside_runs"),
        description="ids of runs (also some of `runs`) that are not used to find or fit effects; the report has the "
        "error on them before and after",
    )
    model: str = Field(
        default=DEFAULT_MODEL,
        max_length=100,
        description="`physics`, `default`, or the id of a trained model",
        examples=["physics"],
    )
    robot: RobotIn | None = Field(default=None, description="robot that drove; default: the 4WD robot of the paper")

    @model_validator(mode="before")
    @classmethod
    def _one_name_each(cls, values: Any) -> Any:
        for name, former in (("baseline_runs", "base_runs"), ("test_runs", "aside_runs")):
            if isinstance(values, dict) and name in values and former in values:
                raise ValueError(f"`{former}` is the former name of `{name}`: give one of them")
        return values


class LocalCalibration(CalibrationOptions):
    """The same of runs that are files."""

    model: ModelPlace = Field(default=DEFAULT_MODEL, description="the model to be calibrated")
    odometry_track_m: Annotated[float, within(TRACK_M)] | None = Field(
        default=None,
        description="effective track width [m]: the runs have no positions, and the wheel speeds of both sides are "
        "integrated",
    )


def ask(
    model: str | Path,
    runs: CalibrationRuns,
    wanted: CalibrationOptions,
    *,
    out: Path,
    progress: Callable[[float], None] | None = None,
) -> Calibrated:
    """Find what a model lacks on runs that are read, and write the calibrated model to `out/model`."""
    from joulemap.service.loop.calibration import calibrate_on_runs, campaigns_of

    return calibrate_on_runs(
        model,
        runs,
        out=out,
        task=None if wanted.start is None or wanted.goal is None else (wanted.start, wanted.goal),
        groups=campaigns_of(runs.segments.runs) if wanted.campaigns else None,
        cross_validate=not wanted.quick,
        seed=wanted.seed,
        progress=progress,
    )
