"""What requests and answers about runs and calibrations look like: every field with its unit."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.schemas.base import JobOut, Point, Problem, Request, ResponseModel, RobotIn, RobotOut


class OdometryOut(ResponseModel):
    """How runs without positions are read."""

    track_m: float = Field(description="distance of the sides as the robot turns [m]", examples=[1.07])
    terrain_from_name: bool = Field(description="whether a file's name says what ground it was driven on")


class RunOut(ResponseModel):
    """What was read of one measured run, and what was left out and why."""

    name: str = Field(description="of its file", examples=["run_01.csv"])
    rows: int = Field(description="rows that are used", examples=[3312])
    seconds: float = Field(description="from the first to the last [s]", examples=[331.1])
    target: Literal["energy_j", "charge_as"] = Field(description="charge where no voltage was recorded")
    columns: list[str] = Field(description="further columns that are kept", examples=[["temperature", "terrain"]])
    segments: int = Field(description="segments of 1 m", examples=[143])
    repairs: dict[str, int] = Field(
        description="rows by the rule that mended or dropped them", examples=[{"held_fixes": 9}]
    )
    left_out: dict[str, int] = Field(description="what was made no segment, by reason", examples=[{"stops": 2}])
    bounds: list[float] = Field(
        min_length=4, max_length=4, description="[west, south, east, north] driven [m]; by odometry, from its start"
    )
    odometry: OdometryOut | None = Field(default=None, description="of a run without positions")


class RunsOut(ResponseModel):
    """Measured runs that were sent together."""

    id: str = Field(examples=["runs-3b9d0c1e77aa"])
    created_at: dt.datetime = Field(description="UTC")
    runs: list[RunOut] = Field(description="one per file")
    links: dict[str, str]


class CalibrationRequest(Request):
    """Which runs to hold against which model."""

    heightmap_id: str | None = Field(
        default=None,
        max_length=100,
        description="that the runs were driven on; runs without positions lie on none",
        examples=["hm-5f0c2a9d41be"],
    )
    runs: list[Annotated[str, Field(max_length=100)]] = Field(
        min_length=1, max_length=100, description="ids of runs", examples=[["runs-3b9d0c1e77aa"]]
    )
    base_runs: list[Annotated[str, Field(max_length=100)]] = Field(
        default=[],
        max_length=100,
        description="ids of runs in which nothing new is at work; default: those the model keeps of its training",
    )
    aside_runs: list[Annotated[str, Field(max_length=100)]] = Field(
        default=[],
        max_length=100,
        description="ids of runs (also of `runs`) that nothing is sought or fitted in; the report has the error on "
        "them before and after",
    )
    model: str = Field(
        default=DEFAULT_MODEL,
        max_length=100,
        description="`physics`, `default`, or the id of a trained model",
        examples=["physics"],
    )
    robot: RobotIn | None = Field(default=None, description="that drove; default: the paper's 4WD robot")
    start: Point | None = Field(
        default=None, description="of the task whose route is compared; default: a few are tried"
    )
    goal: Point | None = Field(default=None, description="likewise")
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="of the permutations")

    @model_validator(mode="after")
    def _whole_task(self) -> CalibrationRequest:
        if (self.start is None) != (self.goal is None):
            raise ValueError("give both `start` and `goal`, or neither")
        return self


class CalibrationOut(JobOut):
    """A calibration: asked for, being made, or done. What is only known when done is null before."""

    id: str = Field(examples=["cal-2f7719c0be04"])
    heightmap_id: str | None = Field(description="null for runs without positions", examples=["hm-5f0c2a9d41be"])
    runs: list[str] = Field(description="ids of the runs")
    base_runs: list[str] = Field(description="ids of the runs that they were held against")
    aside_runs: list[str] = Field(description="ids of the runs that it was only judged by")
    robot: RobotOut
    model: str = Field(description="the model that was calibrated", examples=["physics"])
    calibrated_model: str | None = Field(
        description="the model with what was found, to ask cost maps with; null where nothing was found",
        examples=["cal-2f7719c0be04"],
    )
    report: dict[str, Any] | None = Field(description="what was found, with its evidence; null in lists")
    problem: Problem | None = Field(description="why it failed")
    links: dict[str, str]
