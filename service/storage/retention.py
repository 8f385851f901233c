"""Removes what was not used for a long time, and the cost maps that were not used longest where there is no room."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from sqlalchemy import func, select, update

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.storage.files import bytes_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    CANCELLED,
    DONE,
    FAILED,
    JOBS,
    NO_TIME,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    RunsRow,
    kind_of,
)

_TABLES: tuple[Any, ...] = (HeightmapRow, RunsRow, CostmapRow, CalibrationRow)
_LOG = logging.getLogger("joulemap.service")
_TO_COME = dt.timedelta(days=1)  # more than clocks of several services differ by
_JUST_USED = dt.timedelta(minutes=15)  # longer than a question, and than uses are noted after they happen


def note_uses(store: Store, uses: Mapping[str, dt.datetime]) -> None:
    """Write down when jobs' results were last used. `uses`: time [UTC] by the id of a cost map or a calibration."""
    with store.sessions.begin() as session:
        for job_id, at in uses.items():
            table = JOBS[kind_of(job_id)]
            session.execute(update(table).where(table.id == job_id).values(used_at=at))


def forget_ages(store: Store, now: dt.datetime) -> None:
    """Count the age of everything from now, because the times at which it was used are not known. `now`: [UTC]."""
    with store.sessions.begin() as session:
        for table in _TABLES:
            session.execute(update(table).values(used_at=now))


def remove_unused(
    store: Store,
    delete: Mapping[Any, Callable[[str], object]],
    *,
    now: dt.datetime,
    days: float | None,
    most_bytes: int | None,
) -> list[str]:
    """Remove what is older or larger than the limits; never a job that waits or runs, and nothing that is needed.

    By age go cost maps, then calibrations that no cost map uses, then runs that no calibration uses, then heightmaps
    from which nothing is left. By size go cost maps only, which can be made again.

    `now`: the time [UTC]; `days`: what was not used for so long is removed [days].
    """
    removed = []
    if days is not None:
        oldest = now - dt.timedelta(days=days)
        for table in (CostmapRow, CalibrationRow, RunsRow, HeightmapRow):
            for row_id, _, used in _by_use(store, table, now + _TO_COME):
                if used >= oldest:
                    break
                if _gone(delete[table], row_id):
                    removed.append(row_id)
                    _LOG.info("%s was removed: last used %s, more than %g days ago", row_id, used, days)
    if most_bytes is not None:
        kept = _kept(store)
        for row_id, size, used in _by_use(store, CostmapRow, dt.datetime.max):
            if kept <= most_bytes or used > now - _JUST_USED:
                break
            if size and _gone(delete[CostmapRow], row_id):
                kept -= size
                removed.append(row_id)
                _LOG.info("%s was removed: last used %s, and more than %g GB are kept", row_id, used, most_bytes / 1e9)
        if kept > most_bytes:
            _LOG.warning(
                "%.3g GB are kept, the limit is %.3g GB, and no cost map is left that could be removed",
                kept / 1e9,
                most_bytes / 1e9,
            )
    return removed


def _gone(delete: Callable[[str], object], row_id: str) -> bool:
    with suppress(ConflictError):  # it is needed
        with suppress(NotFoundError):  # somebody else deleted it
            delete(row_id)
        return True
    return False


def _by_use(store: Store, table: Any, latest: dt.datetime) -> list[tuple[str, int | None, dt.datetime]]:
    """Id, size and time of the last use of all rows whose job has ended, least recently used first.

    A time after `latest` was written under another clock; what nobody can date is not old.
    """
    ends = [table.finished_at] if hasattr(table, "finished_at") else []
    query = select(table.id, table.bytes, table.created_at, table.used_at, *ends)
    if ends:
        query = query.where(table.status.in_([DONE, FAILED, CANCELLED]))
    with store.sessions() as session:
        rows = session.execute(query).all()
    found = [
        (row_id, size, max((at for at in times if at is not None and NO_TIME < at <= latest), default=latest))
        for row_id, size, *times in rows
    ]
    return sorted(found, key=lambda row: row[2])


def measure(store: Store) -> None:
    """Measure what an older version kept."""
    for table in _TABLES:
        query = select(table.id).where(table.bytes.is_(None))
        if hasattr(table, "finished_at"):
            query = query.where(table.status == DONE)
        with store.sessions() as session:
            unmeasured = list(session.scalars(query))
        for row_id in unmeasured:
            with store.sessions.begin() as session:
                session.execute(
                    update(table).where(table.id == row_id).values(bytes=bytes_of(store.path(table, row_id)))
                )


def _kept(store: Store) -> int:
    with store.sessions() as session:
        return sum(int(session.scalar(select(func.sum(table.bytes))) or 0) for table in _TABLES)
