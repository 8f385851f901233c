"""Copies a data directory while its service runs, and puts such a copy into its place again.

The database is copied first, as it is at one moment. Files never change once a row says that they are there, so they
can be copied after it. What was deleted meanwhile is left out of the copy.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.engine import Engine
from sqlalchemy.orm import Session

from joulemap.model.errors import ConflictError, InputError
from joulemap.service.storage.files import FOLDER_MODE, remove
from joulemap.service.storage.kept import engine_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    CALIBRATION,
    DONE,
    JOBS,
    Base,
    CalibrationRow,
    HeightmapRow,
    RunsRow,
    Sent,
)

FORMAT = "joulemap.backup/1"
MANIFEST, DATABASE, MODELS = "backup.json", "joulemap.db", "models"
_AT_ONCE = 500  # rows
_CHUNK = 1 << 20  # bytes


def back_up(
    store: Store, target: Path, *, models_dir: Path, progress: Callable[[float], object] = lambda _: None
) -> dict[str, Any]:
    """Copy everything that is kept, whole or not at all; the service may run.

    Result: the manifest: version, time, number of rows of each table, and size and SHA-256 of each file. Raises
    ConflictError if something is at `target`.
    """
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise ConflictError(f"{target} is there already: name a folder that is not there yet", path=str(target))
    partial = target.with_name(f"{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(mode=FOLDER_MODE, parents=True)  # it holds the hashes of the keys
    try:
        _copy_database(store.engine, partial / DATABASE)
        copied = engine_of(f"sqlite:///{partial / DATABASE}")
        files: dict[str, tuple[int, str]] = {}
        with Session(copied) as session:
            wanted = [*_rows(session, store, models_dir), *_trained(models_dir)]
            gone = set()
            for number, (table, row_id, source, place) in enumerate(wanted):
                try:
                    with suppress(FileNotFoundError):  # it is reported below
                        store.vault.fetch(place, source)
                    found = _copy_all(source, partial, place)
                    deleted = table is not None and not _is_there(store, table, row_id)
                except FileNotFoundError:
                    if table is None or _is_there(store, table, row_id):
                        raise
                    deleted = True
                if deleted:
                    gone.add((table, row_id))
                    remove(partial / place)
                else:
                    files |= found
                progress((number + 1) / len(wanted))
            _leave_out(session, gone)
            counts = {t.name: session.scalar(select(func.count()).select_from(t)) for t in _tables()}
        copied.dispose()
        files[DATABASE] = _measure(partial / DATABASE)
        manifest = {
            "format": FORMAT,
            "joulemap": version("joulemap"),
            "created_at": dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            "rows": counts,
            "files": {place: list(found) for place, found in sorted(files.items())},
        }
        (partial / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        if target.exists():
            target.rmdir()
        partial.rename(target)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return manifest


def restore(
    source: Path,
    store: Store,
    data_dir: Path,
    *,
    models_dir: Path,
    progress: Callable[[float], object] = lambda _: None,
) -> dict[str, Any]:
    """Put a copy into the place of an empty data directory; every file is compared with the manifest first.

    Raises ConflictError if something is kept already.
    """
    manifest = _verified(source)
    with store.sessions() as session:
        for table in _tables():
            kept = session.scalar(select(func.count()).select_from(table))
            if kept:
                raise ConflictError(
                    f"there are {kept} rows of {table.name} already: restore into an empty data directory and database",
                    rows=kept,
                )
    files = sorted(manifest["files"].keys() - {DATABASE})
    for number, place in enumerate(files):
        into = models_dir / Path(place).relative_to(MODELS) if place.startswith(f"{MODELS}/") else data_dir / place
        if _copy(source / place, into) != tuple(manifest["files"][place]):
            raise InputError(f"{source / place} changed while it was read: it is damaged", file=place)
        progress((number + 1) / len(files))
    copied = engine_of(f"sqlite:///{source / DATABASE}")
    with Session(copied) as session:
        for _, _, place, key in _rows(session, store, models_dir):
            store.vault.put(key, place)
    with copied.connect() as here, store.engine.begin() as there:  # last: what has a row has its files
        _copy_rows(here, there)
    copied.dispose()
    return manifest


def _tables() -> list[Any]:
    return list(Base.metadata.sorted_tables)


def _copy_database(engine: Engine, place: Path) -> None:
    """The database of one moment, as a SQLite file."""
    if engine.dialect.name == "sqlite":
        with closing(engine.raw_connection()) as connection, closing(sqlite3.connect(place)) as copied:
            connection.driver_connection.backup(copied)  # type: ignore[union-attr]
            copied.execute("pragma journal_mode=delete")  # one file
        return
    copied_engine = engine_of(f"sqlite:///{place}")
    Base.metadata.create_all(copied_engine)
    one_moment = engine.execution_options(isolation_level="REPEATABLE READ")
    with one_moment.connect() as here, copied_engine.begin() as there:
        _copy_rows(here, there)
    copied_engine.dispose()


def _copy_rows(here: Any, there: Any) -> None:
    for table in _tables():
        for rows in here.execute(select(table)).mappings().partitions(_AT_ONCE):
            there.execute(table.insert(), [dict(row) for row in rows])


def _rows(session: Session, store: Store, models_dir: Path) -> Iterator[tuple[Any, str, Path, str]]:
    """All rows with files: table, id, where its files are, and their place in the copy."""
    tables: list[Any] = [HeightmapRow, RunsRow, *JOBS.values()]
    for table in tables:
        query = select(table.id).where(table.gone.is_(None) if issubclass(table, Sent) else table.status == DONE)
        for row_id in session.scalars(query):
            place = store.path(table, row_id)
            yield table, row_id, place, place.relative_to(store.folder).as_posix()
            if table is CalibrationRow:
                yield table, row_id, models_dir / row_id, f"{MODELS}/{row_id}"


def _trained(models_dir: Path) -> Iterator[tuple[None, str, Path, str]]:
    """Models that no calibration made."""
    for folder in sorted(models_dir.iterdir()) if models_dir.is_dir() else ():
        if folder.is_dir() and not folder.name.startswith(f"{CALIBRATION}-"):
            yield None, folder.name, folder, f"{MODELS}/{folder.name}"


def _is_there(store: Store, table: Any, row_id: str) -> bool:
    with store.sessions() as session:
        return session.scalar(select(table.id).where(table.id == row_id)) is not None


def _leave_out(session: Session, gone: set[tuple[Any, str]]) -> None:
    """Remove rows from the copied database; what was made from a heightmap that is gone is gone too."""
    for table, row_id in sorted(gone, key=lambda found: found[0] is HeightmapRow):
        if table is HeightmapRow:
            for jobs in JOBS.values():
                session.execute(delete(jobs).where(jobs.heightmap_id == row_id))
        session.execute(delete(table).where(table.id == row_id))
    session.commit()


def _copy_all(source: Path, target: Path, place: str) -> dict[str, tuple[int, str]]:
    """Copy a file or a folder into the copy. Returns size and SHA-256 of each file by its place there."""
    if source.is_file():
        return {place: _copy(source, target / place)}
    if not source.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(source))
    files = {}
    for path in sorted(source.rglob("*")):
        below = path.relative_to(source)
        if path.is_file() and not any(part.endswith(".partial") for part in below.parts):
            files[f"{place}/{below.as_posix()}"] = _copy(path, target / place / below)
    return files


def _copy(source: Path, target: Path) -> tuple[int, str]:
    """Copy a file to where none is. Returns its size and its SHA-256."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with source.open("rb") as here, target.open("xb") as there:
        while chunk := here.read(_CHUNK):
            digest.update(chunk)
            size += there.write(chunk)
        there.flush()
        os.fsync(there.fileno())
    return size, digest.hexdigest()


def _measure(path: Path) -> tuple[int, str]:
    with path.open("rb") as file:
        return path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()


def _verified(source: Path) -> dict[str, Any]:
    """The manifest of a copy. Raises InputError where it is none, or is damaged."""
    try:
        manifest: dict[str, Any] = json.loads((source / MANIFEST).read_text(encoding="utf-8"))
        form, files = manifest["format"], manifest["files"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        words = f"{source} is no backup of joulemap: it has no readable {MANIFEST}"
        raise InputError(words, path=str(source)) from error
    if form != FORMAT:
        raise InputError(f"{source} has format {form!r}, expected {FORMAT!r}", format=form)
    for place, found in files.items():
        path = source / place
        if not path.resolve().is_relative_to(source.resolve()):
            raise InputError(f"{source} names a file outside of it: {place}", file=place)
        if not path.is_file() or _measure(path) != tuple(found):
            raise InputError(f"{path} is {'damaged' if path.is_file() else 'missing'}: take another backup", file=place)
    return manifest
