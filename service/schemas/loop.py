"""What requests and answers about runs and calibrations look like: every field with its unit."""

from __future__ import annotations

import datetime as dt
from typing import Any, Literal

from pydantic import Field

from joulemap.service.schemas.base import JobOut, Problem, ResponseModel, RobotOut


class OdometryOut(ResponseModel):
    """How runs without positions are read."""

    track_m: float = Field(
        description="effective track width: distance of the two sides as the robot turns [m]", examples=[1.07]
    )
    terrain_from_name: bool = Field(description="whether the name of a file says on what ground it was driven")


class RunOut(ResponseModel):
    """What was read of one measured run, and what was left out and why."""

    name: str = Field(description="name of its file", examples=["run_01.csv"])
    rows: int = Field(description="rows that are used", examples=[3312])
    seconds: float = Field(description="time from the first to the last row [s]", examples=[331.1])
    target: Literal["energy_j", "charge_as"] = Field(description="charge where no voltage was recorded")
    columns: list[str] = Field(
        description="logged columns that are kept beside time, position, voltage and current",
        examples=[["temperature", "terrain"]],
    )
    segments: int = Field(description="number of segments of 1 m", examples=[143])
    repairs: dict[str, int] = Field(
        description="number of rows that were repaired or dropped, by reason", examples=[{"held_fixes": 9}]
    )
    left_out: dict[str, int] = Field(
        description="number of places that are in no segment, by reason", examples=[{"stops": 2}]
    )
    bounds: list[float] = Field(
        min_length=4,
        max_length=4,
        description="[west, south, east, north] of the positions [m]; without positions, from the start",
    )
    odometry: OdometryOut | None = Field(default=None, description="null for a run with positions")
    format: str | None = Field(
        default=None, description="of the file that was sent; null for runs of older versions", examples=["CSV text"]
    )
    reading: dict[str, str] = Field(
        default={},
        description="by column that the log has under another name, in another unit or in messages: what was taken",
        examples=[{"current": "batt_current_mA [mA]"}],
    )
    warnings: list[str] = Field(
        default=[], description="what is implausible and was accepted, and where a log was cut off"
    )
    metres: float | None = Field(default=None, description="length of all segments [m]", examples=[142.6])
    per_m: float | None = Field(
        default=None,
        description="median of the energy [J/m] or charge [A s/m] of a metre; null where a state of charge is all "
        "there is",
        examples=[124.6],
    )
    energy_j: float | None = Field(
        default=None, description="energy of the whole run [J]; null where only charge is known", examples=[17770.0]
    )
    energy_std_j: float | None = Field(
        default=None, description="its standard deviation where it is that of rounded readings [J]", examples=[0.0]
    )
    unknown_seconds: float = Field(
        default=0.0, description="time in which what is drawn was not measured, and is interpolated [s]"
    )
    placed: bool = Field(default=True, description="whether the run has positions; false for a distance alone")
    confidence: dict[str, float] = Field(
        default={},
        description="by column, how sure it is that it was recognised rightly, 0 to 1; 1 is what a mapping says",
        examples=[{"t": 0.99, "current": 0.95}],
    )
    first_rows: dict[str, list[float | None]] = Field(
        default={},
        description="first rows as they were understood",
        examples=[{"t": [0.0, 0.5], "current": [2.1, 2.2]}],
    )


class RunsOut(ResponseModel):
    """Measured runs that were sent together."""

    id: str = Field(examples=["runs-3b9d0c1e77aa"])
    created_at: dt.datetime = Field(description="UTC")
    runs: list[RunOut] = Field(description="one per file")
    links: dict[str, str]


class CalibrationOut(JobOut):
    """A calibration: queued, running, done or failed. Fields that are known when it is done are null before."""

    id: str = Field(examples=["cal-2f7719c0be04"])
    heightmap_id: str | None = Field(description="null for runs without positions", examples=["hm-5f0c2a9d41be"])
    runs: list[str] = Field(description="ids of the runs to learn from")
    baseline_runs: list[str] = Field(description="ids of the earlier runs that they were compared with")
    test_runs: list[str] = Field(description="ids of the runs that the model was only tested with")
    base_runs: list[str] = Field(deprecated=True, description="same as baseline_runs; removed in version 0.3")
    aside_runs: list[str] = Field(deprecated=True, description="same as test_runs; removed in version 0.3")
    robot: RobotOut
    model: str = Field(description="the model that was calibrated", examples=["physics"])
    calibrated_model: str | None = Field(
        description="id of the calibrated model, for cost maps",
        examples=["cal-2f7719c0be04"],
    )
    found: list[str] | None = Field(
        description="names of the effects that were found, in words; in lists too", examples=[["turning"]]
    )
    report: dict[str, Any] | None = Field(
        description="what was found: the content of report.json; null in lists. Keys of former versions are deprecated"
    )
    problem: Problem | None = Field(description="why it failed")
    links: dict[str, str]


class RunSegmentsOut(ResponseModel):
    """Measured and predicted, segment by segment of one run."""

    name: str = Field(description="name of its file", examples=["run_01.csv"])
    x: list[float] = Field(description="middle of each segment [m]")
    y: list[float] = Field(description="[m]")
    measured: list[float] = Field(description="in `unit`, per segment")
    before: list[float] = Field(description="predicted by the model before")
    after: list[float] = Field(description="predicted by the calibrated model, found without this run")


class SegmentsOut(ResponseModel):
    """What was measured and predicted on each segment of 1 m."""

    unit: str = Field(description="J, or A s where no voltage was recorded", examples=["J"])
    runs: list[RunSegmentsOut] = Field(description="one for each run")
