"""What is kept in the data directory: rows in a database; heightmaps, cost maps, runs and reports as files."""

from __future__ import annotations

import contextlib
import datetime as dt
import fcntl
import re
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar

from sqlalchemy import create_engine, delete, event, func, select, text, update
from sqlalchemy.engine import Engine
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.model.terrain.windows import Ground
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice_io import LatticeFolder, load_lattice
from joulemap.service.storage.tables import (
    CALIBRATION,
    COSTMAP,
    DONE,
    FAILED,
    JOBS,
    QUEUED,
    RUNNING,
    WORDS,
    Base,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    JobRow,
    RunsRow,
    StepRow,
    kind_of,
)

Row = TypeVar("Row", bound=Base)

_TABLES_LOCK = 6_201_531  # any number that nothing else in the database locks
_STALE_UPLOAD_S = 86_400.0
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


class Store:
    """Heightmaps, cost maps, runs and calibrations that survive a restart; `open`, then `close`.

    A data directory has one service and any number of workers, which share its database.
    """

    def __init__(self, data_dir: Path, database_url: str) -> None:
        self._dir = data_dir
        self._url = database_url
        self._engine: Engine | None = None
        self._lock: IO[str] | None = None

    def open(self, *, as_service: bool = True) -> None:
        """Create what is missing. Raises ConflictError when another service has the data directory."""
        for name in ("heightmaps", "costmaps", "runs", "calibrations", "uploads"):
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
        write_geotiff(self.heightmap_path(row.id), heightmap)
        with self._sessions.begin() as session:
            session.add(row)
        return row

    def heightmap(self, heightmap_id: str) -> HeightmapRow:
        """The row. Raises NotFoundError."""
        return self._row(HeightmapRow, "is no heightmap", heightmap_id=heightmap_id)

    def open_heightmap(self, heightmap_id: str) -> Ground:
        """The heightmap, read by windows. Raises NotFoundError."""
        return open_ground(self.heightmap_path(heightmap_id), filename=self.heightmap(heightmap_id).name)

    def heightmaps(self, *, limit: int, offset: int) -> tuple[list[HeightmapRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(HeightmapRow, limit, offset)

    def delete_heightmap(self, heightmap_id: str) -> None:
        """Raises NotFoundError, and ConflictError with their ids while something was made from it."""
        row = self.heightmap(heightmap_id)
        try:
            with self._sessions.begin() as session:
                session.delete(row)
        except IntegrityError as error:
            with self._sessions() as session:
                users = {
                    kind: sorted(session.scalars(select(table.id).where(table.heightmap_id == heightmap_id)))
                    for kind, table in JOBS.items()
                }
            ids = [job_id for found in users.values() for job_id in found]
            words = " and ".join(f"{len(found)} {WORDS[kind]}(s)" for kind, found in users.items() if found)
            raise ConflictError(
                f"heightmap {heightmap_id} is used by {words}, {', '.join(ids[:5])}: delete them first",
                costmap_ids=users[COSTMAP],
                calibration_ids=users[CALIBRATION],
            ) from error
        self.heightmap_path(heightmap_id).unlink(missing_ok=True)

    # runs

    def add_runs(self, files: Sequence[tuple[str, Path]], stats: list[dict[str, Any]]) -> RunsRow:
        """Keep runs that were sent together: (name, file) of each. The files first, so that no row ever lacks one."""
        row = RunsRow(id=f"runs-{secrets.token_hex(6)}", created_at=_now(), stats=stats)
        folder = self._runs_folder(row.id)
        folder.mkdir()
        for name, file in files:
            shutil.copyfile(file, folder / safe_name(name))
        with self._sessions.begin() as session:
            session.add(row)
        return row

    def runs(self, runs_id: str) -> RunsRow:
        """The row. Raises NotFoundError."""
        return self._row(RunsRow, "are no runs", runs_id=runs_id)

    def run_files(self, runs_id: str) -> list[Path]:
        """The files of runs that were sent together. Raises NotFoundError."""
        return sorted(self._runs_folder(self.runs(runs_id).id).iterdir())

    def all_runs(self, *, limit: int, offset: int) -> tuple[list[RunsRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(RunsRow, limit, offset)

    def delete_runs(self, runs_id: str) -> None:
        """Raises NotFoundError, and ConflictError with their ids while calibrations were made from them."""
        row = self.runs(runs_id)
        with self._sessions.begin() as session:
            made = session.execute(select(CalibrationRow.id, CalibrationRow.request)).all()
            kinds = ("runs", "base_runs", "aside_runs")
            users = sorted(job_id for job_id, asked in made if any(runs_id in asked.get(kind, []) for kind in kinds))
            if users:
                raise ConflictError(
                    f"runs {runs_id} are used by {len(users)} calibration(s), {', '.join(users[:5])}: "
                    "delete them first",
                    calibration_ids=users,
                )
            session.delete(row)
        shutil.rmtree(self._runs_folder(runs_id), ignore_errors=True)

    # jobs: cost maps and calibrations

    def add_costmap(self, heightmap_id: str, request: dict[str, Any]) -> CostmapRow:
        """A queued cost map. Raises NotFoundError when the heightmap has gone."""
        return self._add(CostmapRow(**_asked(COSTMAP, heightmap_id, request)))

    def add_calibration(self, heightmap_id: str | None, request: dict[str, Any]) -> CalibrationRow:
        """A queued calibration. Raises NotFoundError when the heightmap has gone."""
        return self._add(CalibrationRow(**_asked(CALIBRATION, heightmap_id, request)))

    def _add(self, row: Any) -> Any:
        try:
            with self._sessions.begin() as session:
                session.add(row)
                session.flush()
                session.add(StepRow.first(row))
        except IntegrityError as error:
            raise NotFoundError(f"there is no heightmap {row.heightmap_id!r}", heightmap_id=row.heightmap_id) from error
        return row

    def costmap(self, costmap_id: str) -> CostmapRow:
        """The row. Raises NotFoundError."""
        return self._row(CostmapRow, "is no cost map", costmap_id=costmap_id)

    def calibration(self, calibration_id: str) -> CalibrationRow:
        """The row. Raises NotFoundError."""
        return self._row(CalibrationRow, "is no calibration", calibration_id=calibration_id)

    def costmaps(self, *, limit: int, offset: int) -> tuple[list[CostmapRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(CostmapRow, limit, offset)

    def calibrations(self, *, limit: int, offset: int) -> tuple[list[CalibrationRow], int]:
        """One page, newest first, and how many there are."""
        return self._page(CalibrationRow, limit, offset)

    def status(self, job_id: str) -> str | None:
        """The status of a job; None where there is none."""
        table = JOBS[kind_of(job_id)]
        with self._sessions() as session:
            return session.scalar(select(table.status).where(table.id == job_id))

    def unfinished(self, kind: str = COSTMAP) -> list[str]:
        """Ids of jobs that wait or are being made, oldest first."""
        table = JOBS[kind]
        with self._sessions() as session:
            query = select(table.id).where(table.status.in_([QUEUED, RUNNING]))
            return list(session.scalars(query.order_by(table.created_at)))

    def finish(self, job_id: str, summary: dict[str, Any]) -> bool:
        """Say that what was asked for is there; False when it was deleted meanwhile."""
        return self._end(job_id, status=DONE, progress=1.0, summary=summary)

    def fail(self, job_id: str, problem: dict[str, Any]) -> bool:
        """Keep why it cannot be made; False when it was deleted or is over already."""
        return self._end(job_id, status=FAILED, problem=problem)

    def _end(self, job_id: str, **values: Any) -> bool:
        table = JOBS[kind_of(job_id)]
        with self._sessions.begin() as session:
            at_work = table.status.in_([QUEUED, RUNNING])
            ended = update(table).where(table.id == job_id, at_work).values(finished_at=_now(), **values)
            session.execute(delete(StepRow).where(StepRow.job_id == job_id))
            return bool(session.execute(ended).rowcount)  # type: ignore[attr-defined]

    def load_lattice(self, costmap_id: str) -> CostLattice:
        return load_lattice(self.lattice_path(costmap_id))

    def delete_costmap(self, costmap_id: str) -> None:
        """The row first: a job that still computes it finds it gone. Raises NotFoundError."""
        self._delete(self.costmap(costmap_id))
        LatticeFolder(self.lattice_path(costmap_id)).discard()

    def delete_calibration(self, calibration_id: str) -> None:
        """The row alone. Raises NotFoundError, and ConflictError with their ids while cost maps use its model."""
        row = self.calibration(calibration_id)
        with self._sessions() as session:
            query = select(CostmapRow.id).where(CostmapRow.request["model"].as_string() == calibration_id)
            users = sorted(session.scalars(query))
        if users:
            raise ConflictError(
                f"the model of calibration {calibration_id} is used by {len(users)} cost map(s), "
                f"{', '.join(users[:5])}: delete them first",
                costmap_ids=users,
            )
        self._delete(row)

    def _delete(self, row: JobRow) -> None:
        with self._sessions.begin() as session:
            session.execute(delete(StepRow).where(StepRow.job_id == row.id))
            session.delete(row)

    def lattice_path(self, costmap_id: str) -> Path:
        return self._dir / "costmaps" / f"{costmap_id}.zarr"

    def calibration_folder(self, calibration_id: str) -> Path:
        """Where report.json and report.html of a calibration lie."""
        return self._dir / "calibrations" / calibration_id

    def heightmap_path(self, heightmap_id: str) -> Path:
        return self._dir / "heightmaps" / f"{heightmap_id}.tif"

    def _runs_folder(self, runs_id: str) -> Path:
        return self._dir / "runs" / runs_id

    def _row(self, table: type[Row], there: str, **key: str) -> Row:
        ((name, row_id),) = key.items()
        with self._sessions() as session:
            row = session.get(table, row_id)
        if row is None:
            raise NotFoundError(f"there {there} {row_id[:80]!r}", **{name: row_id[:80]})
        return row

    def _page(self, table: type[Any], limit: int, offset: int) -> tuple[list[Any], int]:
        with self._sessions() as session:
            total = session.scalar(select(func.count()).select_from(table)) or 0
            query = select(table).order_by(table.created_at.desc(), table.id).limit(limit).offset(offset)
            return list(session.scalars(query)), total


def safe_name(name: str) -> str:
    """A name as that of a file in a folder of ours."""
    return _UNSAFE.sub("_", name).lstrip(".")[-100:] or "run"


def _asked(kind: str, heightmap_id: str | None, request: dict[str, Any]) -> dict[str, Any]:
    return {
        "id": f"{kind}-{secrets.token_hex(6)}",
        "created_at": _now(),
        "heightmap_id": heightmap_id,
        "request": request,
        "status": QUEUED,
        "progress": 0.0,
    }


def _now() -> dt.datetime:
    return dt.datetime.now(dt.UTC).replace(tzinfo=None)


def _set_up_sqlite(connection: Any, _record: Any) -> None:
    for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON", "busy_timeout=10000"):
        connection.execute(f"PRAGMA {pragma}")
