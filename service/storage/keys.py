"""Keys of the HTTP service: random secrets of which only a hash is kept, each with a name that owns things."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence

from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import InputError, NotFoundError
from joulemap.service.storage.kept import now
from joulemap.service.storage.tables import JOBS, HeightmapRow, KeyRow, RunsRow

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
