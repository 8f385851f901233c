"""Whose things a caller may see, and how much one caller may keep and run at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session

from joulemap.model.errors import RateError, StorageFullError
from joulemap.service.storage.tables import JOBS, QUEUED, RUNNING, HeightmapRow, RunsRow

_RETRY_S = 10.0  # as a full queue says


@dataclass(frozen=True)
class Caller:
    """On whose behalf the store is asked.

    Attributes
    ----------
    name : str or None
        Owner of what it adds; None where nobody owns it.
    sees_all : bool
        Whether it sees what others own, and what nobody owns.
    jobs : int or None
        Most jobs that wait or run; None without a limit.
    kept_bytes : int or None
        Most bytes of everything that it keeps; None without a limit.
    requests_per_s : float or None
        Most requests per second over a longer time; None without a limit.
    """

    name: str | None = None
    sees_all: bool = True
    jobs: int | None = None
    kept_bytes: int | None = None
    requests_per_s: float | None = None

    def may_see(self, row: Any) -> bool:
        """Return whether a row exists for this caller.

        Result: False for what somebody else owns, and for what nobody owns.
        """
        return self.sees_all or (row.owner is not None and row.owner == self.name)

    def own(self, query: Select[Any], table: Any) -> Select[Any]:
        """Return a query for no rows but those that this caller sees."""
        return query if self.sees_all else query.where(table.owner == self.name)

    def check_room(self, session: Session, more_bytes: int) -> None:
        """Check that the caller may keep more."""
        if self.kept_bytes is None or self.name is None:
            return
        kept = kept_bytes(session, self.name)
        if kept + more_bytes > self.kept_bytes:
            raise StorageFullError(
                f"key {self.name} keeps {kept / 1e9:.3g} GB, and this takes up to {more_bytes / 1e9:.3g} GB more; the "
                f"limit is {self.kept_bytes / 1e9:g} GB: delete what is not needed any more",
                kept_bytes=kept,
                more_bytes=more_bytes,
                limit_bytes=self.kept_bytes,
            )

    def check_jobs(self, session: Session) -> None:
        """Check that the caller may have one more job."""
        if self.jobs is None or self.name is None:
            return
        at_once = sum(
            session.scalar(
                select(func.count())
                .select_from(table)
                .where(table.owner == self.name, table.status.in_([QUEUED, RUNNING]))
            )
            or 0
            for table in JOBS.values()
        )
        if at_once >= self.jobs:
            raise RateError(
                f"key {self.name} has {at_once} jobs that wait or run, its limit is {self.jobs}: ask again when one "
                "has ended",
                jobs=at_once,
                limit=self.jobs,
                retry_after_s=_RETRY_S,
            )


NOBODY = Caller()
"""The service itself, and everybody while there are no keys: it sees all, and what it adds belongs to nobody."""


def promised_bytes(session: Session) -> int:
    """Return the most that jobs take which wait or run [bytes]."""
    unfinished = (select(func.sum(t.bytes)).where(t.status.in_([QUEUED, RUNNING])) for t in JOBS.values())
    return sum(int(session.scalar(query) or 0) for query in unfinished)


def kept_bytes(session: Session, name: str) -> int:
    """Return how much one owner keeps. Result: bytes; a job that is not done counts with the most that it can take."""
    tables: list[Any] = [HeightmapRow, RunsRow, *JOBS.values()]
    return sum(int(session.scalar(select(func.sum(t.bytes)).where(t.owner == name)) or 0) for t in tables)
