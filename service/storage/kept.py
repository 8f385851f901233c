"""What all that is kept has in common: a database, a data folder, a vault, an owner of each row."""

from __future__ import annotations

import contextlib
import copy
import logging
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from sqlalchemy import create_engine, event, func, select, text, update
from sqlalchemy.engine import Engine
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import NotFoundError
from joulemap.service.storage.data_folder import Claims, DataFolder, Room, Upload
from joulemap.service.storage.database import (
    Checkpoints,
    add_missing_columns,
    check_pages,
    check_schema,
    dumps,
    loads,
    note_schema,
)
from joulemap.service.storage.files import bytes_of, changed, close_database, remove, say_what_is_open, sums_of
from joulemap.service.storage.owners import NOBODY, Caller, promised_bytes
from joulemap.service.storage.tables import (
    CALIBRATION,
    Base,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    JobRow,
    RunsRow,
    named_rasters,
    named_test_runs,
    now,
)
from joulemap.service.storage.vault import ObjectVault, damaged, vault_of

Row = TypeVar("Row", bound=Base)

_LOG = logging.getLogger("joulemap.service")

_WAL_PAGES = 10_000
"""Setting: pages of 4 kB after which a commit writes SQLite's log to the database and waits for the disk, where no
service does it (`Checkpoints`)."""
_TABLES_LOCK = 6_201_531  # any number that nothing else in the database locks


class Kept:
    """A database and a data folder; `open` it first, `close` it at the end.

    Several services may share a data directory and its database.
    """

    def __init__(
        self, data_dir: Path, database_url: str, *, objects: str | None = None, least_free_bytes: int = 0
    ) -> None:
        self._dir = data_dir
        self.room = Room(data_dir, least_free_bytes=least_free_bytes)
        self.vault = vault_of(objects)
        self._url = database_url
        self._engine: Engine | None = None
        self._checkpoints: Checkpoints | None = None
        self._folder = DataFolder(data_dir)
        self._caller = NOBODY
        self._adding = threading.Lock()  # so that requests at the same moment do not pass a limit together

    def seen_by(self, caller: Caller) -> Self:
        """Return this store as a caller sees it: what others own is not there, and what is added is the caller's."""
        seen = copy.copy(self)
        seen._caller = caller
        return seen

    def open(self, *, as_service: bool = True, alone: bool = False) -> None:
        """Create the folders and tables that are missing, and remove what killed processes left.

        Raises ConflictError if another service uses the data directory that is to be this one's alone.
        """
        self._folder.make()
        if as_service:
            self._folder.use(alone=alone)
        self._engine = engine_of(self._url)
        file = self._engine.url.database
        if self._engine.dialect.name == "sqlite" and file and not file.startswith((":memory:", "file:")):
            close_database(Path(file))
        if as_service:
            say_what_is_open(self._dir)
        if self._engine.dialect.name == "sqlite":
            event.listen(self._engine, "connect", _set_up_sqlite)
            if as_service and not alone:  # a repair, a restore
                check_pages(self._engine)
        with self._engine.begin() as connection:
            if self._engine.dialect.name == "postgresql":  # services and workers may start at the same moment
                connection.execute(text(f"select pg_advisory_xact_lock({_TABLES_LOCK})"))
            check_schema(connection)
            Base.metadata.create_all(connection)
            add_missing_columns(connection)
            note_schema(connection)
        self._sessions = sessionmaker(self._engine, expire_on_commit=False)
        if as_service:
            self._folder.sweep(self._sessions)
            self.room.keep_reserve()
            if not alone:
                self._folder.share()
            if self._engine.dialect.name == "sqlite" and not alone:
                self._checkpoints = Checkpoints(self._engine)

    @property
    def engine(self) -> Engine:
        """The database of an open store."""
        assert self._engine is not None
        return self._engine

    @property
    def folder(self) -> Path:
        """The data folder."""
        return self._dir

    @property
    def uploads(self) -> Path:
        """The folder of this process for what is not whole yet; the next service sweeps it."""
        return self._folder.uploads

    @property
    def sessions(self) -> sessionmaker[Session]:
        """Sessions of the database of an open store."""
        return self._sessions

    def leftovers(self) -> list[Path]:
        """Return what processes left unfinished that were killed."""
        return self._folder.leftovers(self._sessions)

    def claims(self) -> Claims:
        """Return what this service takes its jobs with."""
        assert self._engine is not None
        return Claims(self._engine, self._dir / "claims")

    def close(self) -> None:
        """Let go of the database and the data directory."""
        if self._checkpoints is not None:
            self._checkpoints.stop()
        if self._engine is not None:
            self._engine.dispose()
        self._folder.leave()

    def unlike(self, table: Any, row_id: str, place: Path) -> Iterator[Path]:
        """Yield the files and folders of a row that have another content than was kept."""
        if isinstance(self.vault, ObjectVault):
            parts = self.vault.parts(str(place.relative_to(self._dir))) or {}
            yield from changed(place, {name: part.sha256 for name, part in parts.items()})
            return
        with self._sessions() as session:
            kept = session.scalar(select(table.sums).where(table.id == row_id))
        yield from changed(place, kept or {})

    @property
    def owner(self) -> str | None:
        """Name of the caller's key; None where it has none."""
        return self._caller.name

    def may_see(self, row: Any) -> bool:
        """Return whether a row is there for the caller."""
        return self._caller.may_see(row)

    def path(self, table: Any, row_id: str) -> Path:
        """Return the file or the folder of a row."""
        return self._dir / str(table.place).format(row_id)

    @contextlib.contextmanager
    def upload_file(self) -> Iterator[Path]:
        """Lend a path for an upload while it is read; the file is removed afterwards."""
        path = self._folder.uploads / secrets.token_hex(8)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def upload(self) -> Iterator[Upload]:
        """Count an upload of the caller as long as it is on its way."""
        upload = Upload(self.room, self.owner)
        try:
            yield upload
        finally:
            upload.end()

    def check_room(self) -> None:
        """Check that the caller and the disk have room for what is on its way. Raises StorageFullError."""
        with self._sessions() as session:
            self._caller.check_room(session, self.room.arriving[self.owner])
            self.room.check(promised_bytes(session))

    def here(self, place: Path) -> Path:
        """Have a file or a folder that is kept in the data folder."""
        with contextlib.suppress(FileNotFoundError):
            self.vault.fetch(self._key(place), place)
        return place

    def intact(self, table: Any, row_id: str, place: Path) -> Path:
        """Have the file or the folder of a row here. Raises DamagedError where it is not what was kept."""
        for part in self.unlike(table, row_id, self.here(place)):
            named = place.name if part == place else f"{place.name}/{part.name}"
            raise damaged(f"{named}: its content is not what was kept", named)
        return place

    def model_here(self, model: str, models_dir: Path) -> None:
        """Have the model of a calibration in the folder of models; others are there or not."""
        if model.startswith(f"{CALIBRATION}-"):
            with contextlib.suppress(FileNotFoundError):
                self.vault.fetch(f"models/{model}", models_dir / model)

    def _key(self, place: Path) -> str:
        """What the vault calls a place in the data folder."""
        return place.relative_to(self._dir).as_posix()

    def _forget(self, place: Path) -> None:
        """Keep a file or a folder no longer. What the object store does not remove now, `joulemap check` finds."""
        try:
            self.vault.remove(self._key(place))
        except OSError as error:
            _LOG.warning("%s is left in the object store: %s", self._key(place), error)
        remove(place)

    def _keep_with(self, row: Any, begun: Path, place: Path) -> None:
        """Keep files, then add their row, so that no row is ever without its files.
        Raises StorageFullError if the owner would keep too much.
        """
        size = bytes_of(begun)
        row.sums = sums_of(begun)
        with self._sessions() as session:
            self._caller.check_room(session, size)
        begun.rename(place)
        try:
            self.vault.put(self._key(place), place)
            self._keep(row, size)
        except BaseException:
            self._forget(place)
            raise

    def _keep(self, row: Any, size: int) -> None:
        """Add a row with its owner.
        Raises StorageFullError if the owner would keep too much, RateError if a job is one too many.
        """
        caller = self._caller
        row.owner, row.bytes = caller.name, size
        with self._adding, self._sessions.begin() as session:
            caller.check_room(session, size)
            if isinstance(row, JobRow):
                caller.check_jobs(session)
                self.room.check(promised_bytes(session) + size)
            session.add(row)
            session.flush()
            for table, ids in _sources(row):  # which waits for who deletes one of them
                used = session.execute(update(table).where(table.id.in_(ids)).values(used_at=now()))
                if table is HeightmapRow and used.rowcount < len(set(ids) - {None}):  # type: ignore[attr-defined]
                    raise NotFoundError(f"one of the heightmaps {', '.join(ids)} was deleted meanwhile")

    def _delete(self, delete: Callable[[Session], object]) -> None:
        """Do what makes room; on a full disk a reserve is given up for it."""
        try:
            with self._sessions.begin() as session:
                delete(session)
        except OperationalError:
            if not self.room.make_a_little():
                raise
            with self._sessions.begin() as session:
                delete(session)

    def _row(self, table: type[Row], there: str, *options: Any, **key: str) -> Row:
        ((name, row_id),) = key.items()
        row = None
        if "\0" not in row_id:  # a text that PostgreSQL has no place for, not even in a question
            with self._sessions() as session:
                row = session.get(table, row_id, options=options)
        if row is None or not self.may_see(row):
            raise NotFoundError(f"there {there} {row_id[:80]!r}", **{name: row_id[:80]})
        return row

    def page(
        self, table: type[Any], limit: int, offset: int, *options: Any, where: Sequence[Any] = ()
    ) -> tuple[list[Any], int]:
        """Return one page of the rows of a table that the caller may see, newest first, and how many there are."""
        with self._sessions() as session:
            own = self._caller.own
            total = session.scalar(own(select(func.count()).select_from(table).where(*where), table)) or 0
            query = own(select(table).where(*where), table).order_by(table.created_at.desc(), table.id)
            return list(session.scalars(query.limit(limit).offset(offset).options(*options))), total


def _sources(row: Any) -> list[tuple[Any, list[str]]]:
    """What a job is made from, by table."""
    if isinstance(row, CalibrationRow):
        asked = row.request
        runs = [*asked["runs"], *asked.get("base_runs", []), *named_test_runs(asked)]
        return [(RunsRow, runs), (HeightmapRow, [row.heightmap_id])]
    if isinstance(row, CostmapRow):
        return [(HeightmapRow, [row.heightmap_id, *named_rasters(row.request).values()])]
    return []


def engine_of(url: str) -> Engine:
    """The engine of a database; that of a PostgreSQL gives up a server that does not answer."""
    if not url.startswith("postgresql"):
        return create_engine(url, pool_pre_ping=True, json_serializer=dumps, json_deserializer=loads)
    from joulemap.service.storage.postgres import PATIENCE, POOL_S, limit  # with a library that is an extra

    engine = create_engine(
        url,
        pool_pre_ping=True,
        pool_timeout=POOL_S,
        json_serializer=dumps,
        json_deserializer=loads,
        connect_args=PATIENCE,
    )
    limit(engine)
    return engine


def _set_up_sqlite(connection: Any, _record: Any) -> None:
    pragmas = "journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON", "busy_timeout=10000"
    for pragma in (*pragmas, f"wal_autocheckpoint={_WAL_PAGES}"):
        connection.execute(f"PRAGMA {pragma}")
    connection.text_factory = lambda text: text.decode("utf-8", "replace")  # a damaged text harms its own row alone
