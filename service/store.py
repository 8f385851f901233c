"""What is kept in the data directory: rows in a database, heightmaps as GeoTIFF, cost maps as zarr."""

from __future__ import annotations

import contextlib
import datetime as dt
import fcntl
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from sqlalchemy import JSON, ForeignKey, Text, create_engine, delete, event, func, select, text, update
from sqlalchemy.engine import Engine
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column, sessionmaker

from model.errors import ConflictError, NotFoundError
from model.terrain.heightmap import Heightmap
from model.terrain.readers import open_ground
from model.terrain.windows import Ground
from model.terrain.writers import write_geotiff
from planner.lattice import CostLattice
from planner.lattice_io import LatticeFolder, load_lattice

QUEUED, RUNNING, DONE, FAILED = "queued", "running", "done", "failed"
LAY_OUT = 0
"""Number of the first step of making a cost map."""

_TABLES_LOCK = 6_201_531  # any number that nothing else in the database locks
_STALE_UPLOAD_S = 86_400.0


class Base(DeclarativeBase):
    """The tables."""


class HeightmapRow(Base):
    """A heightmap that was sent; its heights lie in heightmaps/{id}.tif. `stats` is what a listing tells about it."""

    __tablename__ = "heightmaps"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    name: Mapped[str] = mapped_column(Text)
    stats: Mapped[dict[str, Any]] = mapped_column(JSON)


class CostmapRow(Base):
    """A cost map that was asked for; its lattice lies in costmaps/{id}.zarr once `status` is done."""

    __tablename__ = "costmaps"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[dt.datetime]
    heightmap_id: Mapped[str] = mapped_column(ForeignKey("heightmaps.id"))
    request: Mapped[dict[str, Any]] = mapped_column(JSON)
    status: Mapped[str] = mapped_column(default=QUEUED)
    progress: Mapped[float] = mapped_column(default=0.0)
    finished_at: Mapped[dt.datetime | None]
    summary: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    problem: Mapped[dict[str, Any] | None] = mapped_column(JSON)


class StepRow(Base):
    """One step of making a cost map, see `service.steps`. number : LAY_OUT, a tile's + 1, or that of the last; last :
    waits for all others; worker, lease_until : who is at it, until when [s since 1970, the workers' common clock];
    result : what it found, once done."""

    __tablename__ = "steps"

    costmap_id: Mapped[str] = mapped_column(ForeignKey("costmaps.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    last: Mapped[bool] = mapped_column(default=False)
    done: Mapped[bool] = mapped_column(default=False)
    worker: Mapped[str] = mapped_column(default="")
    lease_until: Mapped[float] = mapped_column(default=0.0)
    result: Mapped[Any | None] = mapped_column(JSON)


class Store:
    """Heightmaps and cost maps that survive a restart; `open`, then `close`.

    A data directory has one service and any number of workers, which share its database.
    """

    def __init__(self, data_dir: Path, database_url: str) -> None:
        self._dir = data_dir
        self._url = database_url
        self._engine: Engine | None = None
        self._lock: IO[str] | None = None

    def open(self, *, as_service: bool = True) -> None:
        """Create what is missing. Raises ConflictError when another service has the data directory."""
        for name in ("heightmaps", "costmaps", "uploads"):
            (self._dir / name).mkdir(parents=True, exist_ok=True)
        if as_service:
            self._lock_directory()
        self._engine = create_engine(self._url, pool_pre_ping=True)
        if self._engine.dialect.name == "sqlite":
            event.listen(self._engine, "connect", _set_up_sqlite)
        with self._engine.begin() as connection:
            if self._engine.dialect.name == "postgresql":  # services and workers may start at the same moment
                connection.execute(text(f"select pg_advisory_xact_lock({_TABLES_LOCK})"))
            Base.metadata.create_all(connection)
        self._sessions = sessionmaker(self._engine, expire_on_commit=False)

    @property
    def sessions(self) -> sessionmaker[Session]:
        """Of an open store's database."""
        return self._sessions

    def _lock_directory(self) -> None:
        lock = (self._dir / "lock").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            lock.close()
            raise ConflictError(
                f"another joulemap service uses the data directory {self._dir}: stop it, or set JOULEMAP_DATA_DIR",
                data_dir=str(self._dir),
            ) from error
        self._lock = lock
        for left in (self._dir / "uploads").iterdir():
            if time.time() - left.stat().st_mtime > _STALE_UPLOAD_S:
                left.unlink()

    def close(self) -> None:
        if self._engine is not None:
            self._engine.dispose()
        if self._lock is not None:
            self._lock.close()

    @contextlib.contextmanager
    def upload_file(self) -> Iterator[Path]:
        """A path for an upload while it is read; gone afterwards."""
        path = self._dir / "uploads" / secrets.token_hex(8)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    # heightmaps

    def add_heightmap(self, heightmap: Heightmap, *, name: str, stats: dict[str, Any]) -> HeightmapRow:
        """Keep a heightmap: the file first, so that no row ever lacks one."""
        row = HeightmapRow(id=f"hm-{secrets.token_hex(6)}", created_at=_now(), name=name, stats=stats)
        write_geotiff(self._heightmap_path(row.id), heightmap)
        with self._sessions.begin() as session:
            session.add(row)
        return row

    def heightmap(self, heightmap_id: str) -> HeightmapRow:
        """The row. Raises NotFoundError."""
        with self._sessions() as session:
            row = session.get(HeightmapRow, heightmap_id)
        if row is None:
            raise NotFoundError(f"there is no heightmap {heightmap_id[:80]!r}", heightmap_id=heightmap_id[:80])
        return row

    def open_heightmap(self, heightmap_id: str) -> Ground:
        """The heightmap, read by windows. Raises NotFoundError."""
        return open_ground(self._heightmap_path(heightmap_id), filename=self.heightmap(heightmap_id).name)

    def heightmaps(self, *, limit: int, offset: int) -> tuple[list[HeightmapRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(HeightmapRow, limit, offset)

    def delete_heightmap(self, heightmap_id: str) -> None:
        """Raises NotFoundError, and ConflictError with their ids while cost maps were made from it."""
        row = self.heightmap(heightmap_id)
        try:
            with self._sessions.begin() as session:
                session.delete(row)
        except IntegrityError as error:
            with self._sessions() as session:
                query = select(CostmapRow.id).where(CostmapRow.heightmap_id == heightmap_id)
                users = sorted(session.scalars(query))
            raise ConflictError(
                f"heightmap {heightmap_id} is used by {len(users)} cost map(s), {', '.join(users[:5])}: "
                "delete them first",
                costmap_ids=users,
            ) from error
        self._heightmap_path(heightmap_id).unlink(missing_ok=True)

    # cost maps

    def add_costmap(self, heightmap_id: str, request: dict[str, Any]) -> CostmapRow:
        """A queued cost map. Raises NotFoundError when the heightmap has gone."""
        row = CostmapRow(
            id=f"cm-{secrets.token_hex(6)}", created_at=_now(), heightmap_id=heightmap_id, request=request,
            status=QUEUED, progress=0.0,
        )  # fmt: skip
        try:
            with self._sessions.begin() as session:
                session.add(row)
                session.flush()
                session.add(StepRow(costmap_id=row.id, number=LAY_OUT))
        except IntegrityError as error:
            raise NotFoundError(f"there is no heightmap {heightmap_id!r}", heightmap_id=heightmap_id) from error
        return row

    def costmap(self, costmap_id: str) -> CostmapRow:
        """The row. Raises NotFoundError."""
        with self._sessions() as session:
            row = session.get(CostmapRow, costmap_id)
        if row is None:
            raise NotFoundError(f"there is no cost map {costmap_id[:80]!r}", costmap_id=costmap_id[:80])
        return row

    def costmaps(self, *, limit: int, offset: int) -> tuple[list[CostmapRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(CostmapRow, limit, offset)

    def status(self, costmap_id: str) -> str | None:
        """The status of a cost map; None where there is none."""
        with self._sessions() as session:
            return session.scalar(select(CostmapRow.status).where(CostmapRow.id == costmap_id))

    def unfinished(self) -> list[str]:
        """Ids of cost maps that wait or are being made, oldest first."""
        with self._sessions() as session:
            query = select(CostmapRow.id).where(CostmapRow.status.in_([QUEUED, RUNNING]))
            return list(session.scalars(query.order_by(CostmapRow.created_at)))

    def finish_costmap(self, costmap_id: str, summary: dict[str, Any]) -> bool:
        """Say that its lattice is there; False when it was deleted meanwhile."""
        return self._end(costmap_id, status=DONE, progress=1.0, summary=summary)

    def fail_costmap(self, costmap_id: str, problem: dict[str, Any]) -> bool:
        """Keep why it cannot be made; False when it was deleted or is over already."""
        return self._end(costmap_id, status=FAILED, problem=problem)

    def _end(self, costmap_id: str, **values: Any) -> bool:
        at_work = CostmapRow.status.in_([QUEUED, RUNNING])
        with self._sessions.begin() as session:
            ended = update(CostmapRow).where(CostmapRow.id == costmap_id, at_work).values(finished_at=_now(), **values)
            session.execute(delete(StepRow).where(StepRow.costmap_id == costmap_id))
            return bool(session.execute(ended).rowcount)  # type: ignore[attr-defined]

    def load_lattice(self, costmap_id: str) -> CostLattice:
        return load_lattice(self.lattice_path(costmap_id))

    def delete_costmap(self, costmap_id: str) -> None:
        """The row first: a job that still computes it finds it gone. Raises NotFoundError."""
        row = self.costmap(costmap_id)
        with self._sessions.begin() as session:
            session.delete(row)
        LatticeFolder(self.lattice_path(costmap_id)).discard()

    def lattice_path(self, costmap_id: str) -> Path:
        return self._dir / "costmaps" / f"{costmap_id}.zarr"

    def _heightmap_path(self, heightmap_id: str) -> Path:
        return self._dir / "heightmaps" / f"{heightmap_id}.tif"

    def _page(self, table: type[Any], limit: int, offset: int) -> tuple[list[Any], int]:
        with self._sessions() as session:
            total = session.scalar(select(func.count()).select_from(table)) or 0
            query = select(table).order_by(table.created_at.desc(), table.id).limit(limit).offset(offset)
            return list(session.scalars(query)), total


def _now() -> dt.datetime:
    return dt.datetime.now(dt.UTC).replace(tzinfo=None)


def _set_up_sqlite(connection: Any, _record: Any) -> None:
    for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON", "busy_timeout=10000"):
        connection.execute(f"PRAGMA {pragma}")
