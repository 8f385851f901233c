"""Whose things a caller may see, how much one may keep and run at once, and the keys by which callers are known."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, func, or_, select, update
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import InputError, NotFoundError, RateError, StorageFullError
from joulemap.service.storage.tables import JOBS, QUEUED, RUNNING, HeightmapRow, KeyRow, RunsRow, now

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


_KEY = re.compile(r"(jm_[0-9a-f]{8})_[A-Za-z0-9_-]{43}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")


def fits(row: KeyRow, key: str) -> bool:
    """Return whether a key is that of a row and is still valid.

    Result: found in a time that does not depend on where two hashes differ.
    """
    return hmac.compare_digest(row.digest, _digest(key)) and row.revoked_at is None


def prefix_of(key: str) -> str | None:
    """Return the part of a key by which it is found. Result: None where it does not look like a key."""
    match = _KEY.fullmatch(key)
    return match[1] if match else None


def add_key(
    sessions: sessionmaker[Session],
    name: str,
    *,
    operator: bool = False,
    adopt: bool = False,
    **limits: float | None,
) -> str:
    """Add a key. `limits`: `jobs`, `gb` and `requests_per_s`, as columns of its row; None for those of the settings."""
    if not _NAME.fullmatch(name):
        raise InputError(
            f"{name[:80]!r} cannot be the name of a key: use up to 64 letters, digits and . _ @ -", name=name[:80]
        )
    prefix = f"jm_{secrets.token_hex(4)}"
    key = f"{prefix}_{secrets.token_urlsafe(32)}"
    row = KeyRow(prefix=prefix, digest=_digest(key), name=name, operator=operator, created_at=now(), **limits)
    with sessions.begin() as session:
        session.add(row)
        if adopt:
            for table in (HeightmapRow, RunsRow, *JOBS.values()):
                session.execute(update(table).where(table.owner.is_(None)).values(owner=name))
    return key


def all_keys(sessions: sessionmaker[Session]) -> Sequence[KeyRow]:
    """Return all keys, also the revoked ones."""
    with sessions() as session:
        return session.scalars(select(KeyRow).order_by(KeyRow.created_at, KeyRow.prefix)).all()


def revoke_keys(sessions: sessionmaker[Session], which: str) -> int:
    """Revoke the keys of a name, or the one key with a prefix. Raises NotFoundError if no valid key is called so."""
    valid = KeyRow.revoked_at.is_(None) & or_(KeyRow.name == which, KeyRow.prefix == which)
    with sessions.begin() as session:
        count: int = session.execute(update(KeyRow).where(valid).values(revoked_at=now())).rowcount  # type: ignore[attr-defined]
    if count == 0:
        raise NotFoundError(f"there is no valid key {which[:80]!r}: `joulemap keys list` has all", name=which[:80])
    return count


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()
