"""The tables of the service's database: what was sent, and what was asked for."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Any, ClassVar

from sqlalchemy import JSON, BigInteger, Column, DateTime, Dialect, ForeignKey, Integer, MetaData, Table, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeDecorator

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"


NO_TIME = dt.datetime.min
"""Stands for a text that is no time; a key that was revoked then stays revoked."""

SCHEMA = 2
"""Version of these tables: the next one where a version of joulemap before it would read or write them wrongly."""


class _Time(TypeDecorator[dt.datetime]):
    """A time, or NO_TIME where the database has a damaged one, so that no other row is lost with it."""

    impl = DateTime
    cache_ok = True

    def result_processor(self, dialect: Dialect, coltype: object) -> Any:
        """Return what reads a stored value."""
        read = self.impl_instance.result_processor(dialect, coltype) or (lambda value: value)

        def _read(value: Any) -> Any:
            try:
                return read(value)
            except (ValueError, TypeError):
                return NO_TIME

        return _read


class Base(DeclarativeBase):
    """Base of all tables."""

    type_annotation_map = {dt.datetime: _Time}  # noqa: RUF012 - as SQLAlchemy declares it


SCHEMA_VERSION = Table("schema_version", MetaData(), Column("version", Integer))
"""The version of the tables, in one row; no part of what is copied, which is written into tables of today."""


class Kept:
    """What is said of everything that is kept.

    Attributes
    ----------
    place : str
        Its file or folder in the data folder, by its id.
    owner : str or None
        Name of the key with which it was sent or asked for; None where there were no keys.
    bytes : int or None
        Size of its files; of a job that is not done, the most that it can take. None where it was not measured.
    used_at : datetime or None
        When it was last used, UTC, to some minutes; None where it was not used since it was added.
    sums : dict or None
        Checksums of its files, as `sums_of` returns them; None for what an older version kept, what is not done, and
        in an object store, whose records have them. Loaded only when a query names it.
    """

    place: ClassVar[str]
    owner: Mapped[str | None] = mapped_column(index=True)
    bytes: Mapped[int | None] = mapped_column(BigInteger)
    used_at: Mapped[dt.datetime | None]
    sums: Mapped[dict[str, str] | None] = mapped_column(JSON(none_as_null=True), deferred=True)


class KeyRow(Base):
    """A key of the HTTP service. A name may have several keys, so that one can be replaced by another.

    Attributes
    ----------
    prefix : str
        The beginning of the key, by which it is found and shown.
    digest : str
        SHA-256 of the whole key. A key has 256 random bits: no list of likely keys exists, so a slow hash adds nothing.
    name : str
        Owner of what is sent and made with the key.
    operator : bool
        Whether it sees everything, and the metrics.
    revoked_at : datetime or None
        UTC; a revoked key stays in the table, so that a service that had keys does not become open.
    """

    __tablename__ = "keys"

    prefix: Mapped[str] = mapped_column(primary_key=True)
    digest: Mapped[str]
    name: Mapped[str] = mapped_column(index=True)
    operator: Mapped[bool] = mapped_column(default=False)
    created_at: Mapped[dt.datetime]
    revoked_at: Mapped[dt.datetime | None]
    jobs: Mapped[int | None]
    gb: Mapped[float | None]
    requests_per_s: Mapped[float | None]


class Sent(Kept):
    """What was sent, and cannot be made again.

    Attributes
    ----------
    gone : str or None
        What was wrong with its files when a repair put them away; None while they are there.
    """

    gone: Mapped[str | None] = mapped_column(Text)


class HeightmapRow(Sent, Base):
    """A heightmap that was sent; its heights are in heightmaps/{id}.tif, `stats` is what a listing says about it."""

    __tablename__, place = "heightmaps", "heightmaps/{}.tif"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    name: Mapped[str] = mapped_column(Text)
    stats: Mapped[dict[str, Any]] = mapped_column(JSON)


class RunsRow(Sent, Base):
    """Measured runs that were sent together; their files are in runs/{id}/, `stats` is what was read of each."""

    __tablename__, place = "runs", "runs/{}"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    stats: Mapped[list[dict[str, Any]]] = mapped_column(JSON)


class JobRow(Kept, Base):
    """What was asked for and how far it is; `summary` is set once it is done, `problem` once it has failed."""

    __abstract__ = True

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    request: Mapped[dict[str, Any]] = mapped_column(JSON)
    status: Mapped[str] = mapped_column(default=QUEUED)
    progress: Mapped[float] = mapped_column(default=0.0)
    finished_at: Mapped[dt.datetime | None]
    summary: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    problem: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))


class CostmapRow(JobRow):
    """A cost map that was asked for; its lattice is in costmaps/{id}.zarr once `status` is done."""

    __tablename__, place = "costmaps", "costmaps/{}.zarr"

    heightmap_id: Mapped[str] = mapped_column(ForeignKey("heightmaps.id"))

    @property
    def robot(self) -> dict[str, Any]:
        """The robot that was asked for; once the map is done, with the energy of turning that the model learned."""
        made: dict[str, Any] = (self.summary or {}).get("robot", self.request["robot"])
        return made


class CalibrationRow(JobRow):
    """A calibration that was asked for; its report is in calibrations/{id}/ once `status` is done.

    Runs without positions belong to no heightmap.
    """

    __tablename__, place = "calibrations", "calibrations/{}"

    heightmap_id: Mapped[str | None] = mapped_column(ForeignKey("heightmaps.id"))


class DriveRow(Base):
    """A drive that is followed over a cost map, which may be deleted meanwhile.

    Attributes
    ----------
    request : dict
        The route and the battery.
    updates : int
        How often `state` was replaced: who replaces another one than he read does so in vain.
    state, forecast : dict
        What is known of the drive, and of its rest.
    unused : int or None
        Samples that were too late or there already; empty in older tables.
    """

    __tablename__ = "drives"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    owner: Mapped[str | None] = mapped_column(index=True)
    costmap_id: Mapped[str] = mapped_column(index=True)
    request: Mapped[dict[str, Any]] = mapped_column(JSON)
    updates: Mapped[int] = mapped_column(default=0)
    unused: Mapped[int | None] = mapped_column(default=0)
    state: Mapped[dict[str, Any]] = mapped_column(JSON)
    forecast: Mapped[dict[str, Any]] = mapped_column(JSON)


DRIVE = "dr"
"""How the ids of drives begin."""
COSTMAP, CALIBRATION = "cm", "cal"
"""Kinds of jobs: how their ids begin."""
JOBS: dict[str, type[CostmapRow] | type[CalibrationRow]] = {COSTMAP: CostmapRow, CALIBRATION: CalibrationRow}
WORDS = {COSTMAP: "cost map", CALIBRATION: "calibration"}


def kind_of(job_id: str) -> str:
    """Return the kind of a job."""
    return job_id.partition("-")[0]


def named_rasters(request: Mapping[str, Any]) -> dict[str, str]:
    """Return the ids of the rasters that a cost map was asked for with, by the layers that they are.

    A layer of GeoJSON may have any member beside its type.
    """
    return {role: one["heightmap_id"] for role, one in request.get("layers", {}).items() if "type" not in one}


def named_test_runs(request: Mapping[str, Any]) -> list[str]:
    """Return the ids of the runs that a calibration was only tested with."""
    named: list[str] = request.get("test_runs", request.get("aside_runs", []))
    return named


def now() -> dt.datetime:
    """Return the time as rows have it."""
    return dt.datetime.now(dt.UTC).replace(tzinfo=None)
