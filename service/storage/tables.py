"""The tables of the service's database: what was sent, what was asked for, and the steps of making it."""

from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import JSON, ForeignKey, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

QUEUED, RUNNING, DONE, FAILED = "queued", "running", "done", "failed"
LAY_OUT = 0
"""Number of the first step of a job."""


class Base(DeclarativeBase):
    """The tables."""


class HeightmapRow(Base):
    """A heightmap that was sent; its heights lie in heightmaps/{id}.tif. `stats` is what a listing tells about it."""

    __tablename__ = "heightmaps"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    name: Mapped[str] = mapped_column(Text)
    stats: Mapped[dict[str, Any]] = mapped_column(JSON)


class RunsRow(Base):
    """Measured runs that were sent together; their files lie in runs/{id}/. `stats` is what was read of each."""

    __tablename__ = "runs"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    stats: Mapped[list[dict[str, Any]]] = mapped_column(JSON)


class JobRow(Base):
    """What was asked for, and how far it is. summary : once it is done; problem : once it failed."""

    __abstract__ = True

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    request: Mapped[dict[str, Any]] = mapped_column(JSON)
    status: Mapped[str] = mapped_column(default=QUEUED)
    progress: Mapped[float] = mapped_column(default=0.0)
    finished_at: Mapped[dt.datetime | None]
    summary: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    problem: Mapped[dict[str, Any] | None] = mapped_column(JSON)


class CostmapRow(JobRow):
    """A cost map that was asked for; its lattice lies in costmaps/{id}.zarr once `status` is done."""

    __tablename__ = "costmaps"

    heightmap_id: Mapped[str] = mapped_column(ForeignKey("heightmaps.id"))

    @property
    def robot(self) -> dict[str, Any]:
        """As it was asked for; once it is done, with what the model found its turns to cost."""
        made: dict[str, Any] = (self.summary or {}).get("robot", self.request["robot"])
        return made


class CalibrationRow(JobRow):
    """A calibration that was asked for; its report lies in calibrations/{id}/ once `status` is done. Runs without
    positions lie on no heightmap.
    """

    __tablename__ = "calibrations"

    heightmap_id: Mapped[str | None] = mapped_column(ForeignKey("heightmaps.id"))


COSTMAP, CALIBRATION = "cm", "cal"
"""Kinds of jobs: how their ids begin."""
JOBS: dict[str, type[CostmapRow] | type[CalibrationRow]] = {COSTMAP: CostmapRow, CALIBRATION: CalibrationRow}
WORDS = {COSTMAP: "cost map", CALIBRATION: "calibration"}


def kind_of(job_id: str) -> str:
    """COSTMAP or CALIBRATION."""
    return job_id.partition("-")[0]


class StepRow(Base):
    """One step of a job, see `jobs.steps`. created_at : of the job; number : LAY_OUT, a tile's + 1, or that of
    the last; last : waits for all others; worker, lease_until : who is at it, until when [s since 1970, the workers'
    common clock]; result : what it found, once done.
    """

    __tablename__ = "job_steps"

    job_id: Mapped[str] = mapped_column(primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str]
    created_at: Mapped[dt.datetime]
    last: Mapped[bool] = mapped_column(default=False)
    done: Mapped[bool] = mapped_column(default=False)
    worker: Mapped[str] = mapped_column(default="")
    lease_until: Mapped[float] = mapped_column(default=0.0)
    result: Mapped[Any | None] = mapped_column(JSON)

    @classmethod
    def first(cls, job: JobRow) -> StepRow:
        """The step that a job begins with; a calibration has no other."""
        kind = kind_of(job.id)
        return cls(job_id=job.id, number=LAY_OUT, kind=kind, created_at=job.created_at, last=kind == CALIBRATION)
