"""What is kept in the data directory: rows in a database; heightmaps, cost maps, runs and reports as files."""

from __future__ import annotations

import contextlib
import copy
import datetime as dt
import logging
import re
import secrets
import shutil
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import create_engine, event, func, select, text, update
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
from joulemap.service.storage.claims import Claims
from joulemap.service.storage.columns import add_missing_columns
from joulemap.service.storage.data_folder import DataFolder
from joulemap.service.storage.finite import dumps
from joulemap.service.storage.owners import NOBODY, Caller
from joulemap.service.storage.sizes import bytes_of
from joulemap.service.storage.tables import (
    CALIBRATION,
    CANCELLED,
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
    kind_of,
    named_test_runs,
)
from joulemap.service.storage.vault import vault_of

Row = TypeVar("Row", bound=Base)

_LOG = logging.getLogger("joulemap.service")

_TABLES_LOCK = 6_201_531  # any number that nothing else in the database locks
_PATIENCE = {"connect_timeout": 5, "tcp_user_timeout": 15_000}  # [s, ms] with a PostgreSQL; libpq's are minutes
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


class Store:
    """Heightmaps, cost maps, runs and calibrations that survive a restart; `open` it first, `close` it at the end.

    Several services may share a data directory and its database.

    Parameters
    ----------
    data_dir : Path
        Folder of all files.
    database_url : str
        SQLAlchemy URL.
    objects : str, optional
        URL of an object store in which everything is kept; the folder has copies then.
    """

    def __init__(self, data_dir: Path, database_url: str, *, objects: str | None = None) -> None:
        self._dir = data_dir
        self.vault = vault_of(objects)
        self._url = database_url
        self._engine: Engine | None = None
        self._folder = DataFolder(data_dir)
        self._caller = NOBODY
        self._adding = threading.Lock()  # so that requests at the same moment do not pass a limit together

    def seen_by(self, caller: Caller) -> Store:
        """Return this store as a caller sees it: what others own is not there, and what is added is the caller's.

        Parameters
        ----------
        caller : Caller
            On whose behalf it is asked.

        Returns
        -------
        Store
            Open as long as this one is.
        """
        seen = copy.copy(self)
        seen._caller = caller
        return seen

    def open(self, *, as_service: bool = True, alone: bool = False) -> None:
        """Create the folders and tables that are missing, and remove what killed processes left.

        Parameters
        ----------
        as_service : bool, optional
            Whether this is a service, and not a command that looks at the data directory beside it.
        alone : bool, optional
            Whether no other service may use the data directory meanwhile.

        Raises
        ------
        ConflictError
            If another service uses the data directory that is to be this one's alone.
        """
        self._folder.make()
        if as_service:
            self._folder.use(alone=alone)
        patience = _PATIENCE if self._url.startswith("postgresql") else {}
        self._engine = create_engine(self._url, pool_pre_ping=True, json_serializer=dumps, connect_args=patience)
        if self._engine.dialect.name == "sqlite":
            event.listen(self._engine, "connect", _set_up_sqlite)
        with self._engine.begin() as connection:
            if self._engine.dialect.name == "postgresql":  # services and workers may start at the same moment
                connection.execute(text(f"select pg_advisory_xact_lock({_TABLES_LOCK})"))
            Base.metadata.create_all(connection)
            add_missing_columns(connection)
        self._sessions = sessionmaker(self._engine, expire_on_commit=False)
        if as_service:
            self._folder.sweep(self._sessions)
            if not alone:
                self._folder.share()

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
        if self._engine is not None:
            self._engine.dispose()
        self._folder.leave()

    @contextlib.contextmanager
    def upload_file(self) -> Iterator[Path]:
        """Lend a path for an upload while it is read; the file is removed afterwards.

        Yields
        ------
        Path
            Of no file yet.
        """
        path = self._folder.uploads / secrets.token_hex(8)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def here(self, place: Path) -> Path:
        """Have a file or a folder that is kept in the data folder.

        Parameters
        ----------
        place : Path
            As `heightmap_path`, `lattice_path`, `runs_folder` or `calibration_folder` say it.

        Returns
        -------
        Path
            The same; what is not kept is not there.

        Raises
        ------
        OSError
            If the object store does not answer.
        """
        with contextlib.suppress(FileNotFoundError):
            self.vault.fetch(self._key(place), place)
        return place

    def model_here(self, model: str, models_dir: Path) -> None:
        """Have the model of a calibration in the folder of models; others are there or not.

        Parameters
        ----------
        model : str
            Its name.
        models_dir : Path
            Folder of trained models.

        Raises
        ------
        OSError
            If the object store does not answer.
        """
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
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink(missing_ok=True)

    def _keep_with(self, row: Any, begun: Path, place: Path) -> None:
        """Keep files, then add their row, so that no row is ever without its files.
        Raises StorageFullError if the owner would keep too much.
        """
        size = bytes_of(begun)
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
            session.add(row)
            session.flush()
            for table, ids in _sources(row):
                session.execute(update(table).where(table.id.in_(ids)).values(used_at=_now()))

    # heightmaps

    def add_heightmap(self, heightmap: Heightmap | Path, *, name: str, stats: dict[str, Any]) -> HeightmapRow:
        """Keep a heightmap, so that no row is ever without its file.

        Parameters
        ----------
        heightmap : Heightmap or Path
            What to keep, or its GeoTIFF in the folder of uploads, which is moved.
        name : str
            Its name for people.
        stats : dict
            What a listing says about it, JSON-able.

        Returns
        -------
        HeightmapRow
            The new row.
        """
        row = HeightmapRow(id=f"hm-{secrets.token_hex(6)}", created_at=_now(), name=name, stats=stats)
        with self.upload_file() as begun:
            if isinstance(heightmap, Path):
                heightmap.replace(begun)
            else:
                write_geotiff(begun, heightmap)
            self._keep_with(row, begun, self.heightmap_path(row.id))
        return row

    def heightmap(self, heightmap_id: str) -> HeightmapRow:
        """Return the row of a heightmap.

        Parameters
        ----------
        heightmap_id : str
            Its id.

        Returns
        -------
        HeightmapRow
            As it is in the database.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return self._row(HeightmapRow, "is no heightmap", heightmap_id=heightmap_id)

    def open_heightmap(self, heightmap_id: str) -> Ground:
        """Open a heightmap to read it by windows.

        Parameters
        ----------
        heightmap_id : str
            Its id.

        Returns
        -------
        Ground
            Whose heights are read as they are needed.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        name = self.heightmap(heightmap_id).name
        return open_ground(self.here(self.heightmap_path(heightmap_id)), filename=name)

    def heightmaps(self, *, limit: int, offset: int) -> tuple[list[HeightmapRow], int]:
        """Return one page of the heightmaps, newest first.

        Parameters
        ----------
        limit : int
            Most rows of a page.
        offset : int
            Rows to skip.

        Returns
        -------
        rows : list
            Those of the page.
        total : int
            How many there are in all.
        """
        return self._page(HeightmapRow, limit, offset)

    def delete_heightmap(self, heightmap_id: str) -> None:
        """Delete a heightmap from which nothing was made.

        Parameters
        ----------
        heightmap_id : str
            Its id.

        Raises
        ------
        NotFoundError
            If there is none.
        ConflictError
            If cost maps or calibrations were made from it; their ids are in the context.
        """
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
        self._forget(self.heightmap_path(heightmap_id))

    # runs

    def add_runs(self, files: Sequence[tuple[str, Path]], stats: list[dict[str, Any]]) -> RunsRow:
        """Keep runs that were sent together, so that no row is ever without its files.

        Parameters
        ----------
        files : sequence of (str, Path)
            Name and file of each.
        stats : list of dict
            What was read of each, JSON-able.

        Returns
        -------
        RunsRow
            The new row.
        """
        row = RunsRow(id=f"runs-{secrets.token_hex(6)}", created_at=_now(), stats=stats)
        begun = self._folder.uploads / row.id
        begun.mkdir()
        try:
            for name, file in files:
                shutil.copyfile(file, begun / safe_name(name))
            self._keep_with(row, begun, self.runs_folder(row.id))
        finally:
            shutil.rmtree(begun, ignore_errors=True)
        return row

    def runs(self, runs_id: str) -> RunsRow:
        """Return the row of runs that were sent together.

        Parameters
        ----------
        runs_id : str
            Their id.

        Returns
        -------
        RunsRow
            As it is in the database.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return self._row(RunsRow, "are no runs", runs_id=runs_id)

    def run_files(self, runs_id: str) -> list[Path]:
        """Return the files of runs that were sent together.

        Parameters
        ----------
        runs_id : str
            Their id.

        Returns
        -------
        list of Path
            Sorted by name.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return sorted(self.here(self.runs_folder(self.runs(runs_id).id)).iterdir())

    def all_runs(self, *, limit: int, offset: int) -> tuple[list[RunsRow], int]:
        """Return one page of the uploads of runs, newest first.

        Parameters
        ----------
        limit : int
            Most rows of a page.
        offset : int
            Rows to skip.

        Returns
        -------
        rows : list
            Those of the page.
        total : int
            How many there are in all.
        """
        return self._page(RunsRow, limit, offset)

    def delete_runs(self, runs_id: str) -> None:
        """Delete runs that no calibration uses.

        Parameters
        ----------
        runs_id : str
            Their id.

        Raises
        ------
        NotFoundError
            If there are none.
        ConflictError
            If calibrations use them; their ids are in the context.
        """
        row = self.runs(runs_id)
        with self._sessions.begin() as session:
            made = session.execute(select(CalibrationRow.id, CalibrationRow.request)).all()
            users = sorted(
                job_id
                for job_id, asked in made
                if runs_id in (*asked["runs"], *asked.get("base_runs", []), *named_test_runs(asked))
            )
            if users:
                raise ConflictError(
                    f"runs {runs_id} are used by {len(users)} calibration(s), {', '.join(users[:5])}: "
                    "delete them first",
                    calibration_ids=users,
                )
            session.delete(row)
        self._forget(self.runs_folder(runs_id))

    # jobs: cost maps and calibrations

    def add_costmap(self, heightmap_id: str, request: dict[str, Any], *, most_bytes: int = 0) -> CostmapRow:
        """Add a cost map to the queue.

        Parameters
        ----------
        heightmap_id : str
            Id of the heightmap that it is made from.
        request : dict
            Robot, model, spacing and headings, JSON-able.
        most_bytes : int, optional
            The most that it can take on disk.

        Returns
        -------
        CostmapRow
            The new row.

        Raises
        ------
        NotFoundError
            If the heightmap was deleted.
        StorageFullError
            If the caller would keep more than it may.
        RateError
            If the caller has as many jobs as it may.
        """
        return self._add(CostmapRow(**_asked(COSTMAP, heightmap_id, request)), most_bytes)

    def add_calibration(self, heightmap_id: str | None, request: dict[str, Any]) -> CalibrationRow:
        """Add a calibration to the queue.

        Parameters
        ----------
        heightmap_id : str or None
            Id of the heightmap that the runs were driven on; None for runs without positions.
        request : dict
            Runs, model, robot and settings, JSON-able.

        Returns
        -------
        CalibrationRow
            The new row.

        Raises
        ------
        NotFoundError
            If the heightmap was deleted.
        StorageFullError
            If the caller keeps as much as it may.
        RateError
            If the caller has as many jobs as it may.
        """
        return self._add(CalibrationRow(**_asked(CALIBRATION, heightmap_id, request)))

    def _add(self, row: Any, size: int = 0) -> Any:
        try:
            self._keep(row, size)
        except IntegrityError as error:
            raise NotFoundError(f"there is no heightmap {row.heightmap_id!r}", heightmap_id=row.heightmap_id) from error
        return row

    def costmap(self, costmap_id: str) -> CostmapRow:
        """Return the row of a cost map.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Returns
        -------
        CostmapRow
            As it is in the database.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return self._row(CostmapRow, "is no cost map", costmap_id=costmap_id)

    def calibration(self, calibration_id: str) -> CalibrationRow:
        """Return the row of a calibration.

        Parameters
        ----------
        calibration_id : str
            Its id.

        Returns
        -------
        CalibrationRow
            As it is in the database.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return self._row(CalibrationRow, "is no calibration", calibration_id=calibration_id)

    def costmaps(self, *, limit: int, offset: int) -> tuple[list[CostmapRow], int]:
        """Return one page of the cost maps, newest first.

        Parameters
        ----------
        limit : int
            Most rows of a page.
        offset : int
            Rows to skip.

        Returns
        -------
        rows : list
            Those of the page.
        total : int
            How many there are in all.
        """
        return self._page(CostmapRow, limit, offset)

    def calibrations(self, *, limit: int, offset: int) -> tuple[list[CalibrationRow], int]:
        """Return one page of the calibrations, newest first.

        Parameters
        ----------
        limit : int
            Most rows of a page.
        offset : int
            Rows to skip.

        Returns
        -------
        rows : list
            Those of the page.
        total : int
            How many there are in all.
        """
        return self._page(CalibrationRow, limit, offset)

    def status(self, job_id: str) -> str | None:
        """Return the status of a job.

        Parameters
        ----------
        job_id : str
            Its id.

        Returns
        -------
        str or None
            None where there is no such job.
        """
        table = JOBS[kind_of(job_id)]
        with self._sessions() as session:
            return session.scalar(select(table.status).where(table.id == job_id))

    def unfinished(self, kind: str = COSTMAP) -> list[str]:
        """Return the ids of jobs that wait or run, oldest first.

        Parameters
        ----------
        kind : str, optional
            COSTMAP or CALIBRATION.

        Returns
        -------
        list of str
            Ids.
        """
        table = JOBS[kind]
        with self._sessions() as session:
            query = select(table.id).where(table.status.in_([QUEUED, RUNNING]))
            return list(session.scalars(query.order_by(table.created_at)))

    def wanted(self) -> dict[str, float]:
        """Return all jobs that wait or run.

        Returns
        -------
        dict of str to float
            When each was asked for [s since 1970], by its id.
        """
        found: dict[str, float] = {}
        with self._sessions() as session:
            for table in JOBS.values():
                query = select(table.id, table.created_at).where(table.status.in_([QUEUED, RUNNING]))
                found |= {job_id: at.replace(tzinfo=dt.UTC).timestamp() for job_id, at in session.execute(query)}
        return found

    def alike(self, row: CostmapRow) -> list[str]:
        """Return the finished cost maps that differ from one in nothing but the model.

        Parameters
        ----------
        row : CostmapRow
            The one.

        Returns
        -------
        list of str
            Ids.
        """

        def _but_model(request: dict[str, Any]) -> dict[str, Any]:
            return {key: value for key, value in request.items() if key != "model"}

        with self._sessions() as session:
            query = select(CostmapRow).where(CostmapRow.heightmap_id == row.heightmap_id, CostmapRow.status == DONE)
            return [made.id for made in session.scalars(query) if _but_model(made.request) == _but_model(row.request)]

    def report(self, job_id: str, progress: float) -> None:
        """Note how far a job is.

        Parameters
        ----------
        job_id : str
            Its id.
        progress : float
            Share that is done, 0..1.
        """
        table = JOBS[kind_of(job_id)]
        with self._sessions.begin() as session:
            at_work = update(table).where(table.id == job_id, table.status.in_([QUEUED, RUNNING]))
            session.execute(at_work.values(status=RUNNING, progress=progress))

    def finish(self, job_id: str, summary: dict[str, Any]) -> bool:
        """Mark a job as done.

        Parameters
        ----------
        job_id : str
            Its id.
        summary : dict
            What came out, JSON-able.

        Returns
        -------
        bool
            False where the job was deleted meanwhile.
        """
        return self._end(job_id, status=DONE, progress=1.0, summary=summary)

    def fail(self, job_id: str, problem: dict[str, Any]) -> bool:
        """Mark a job as failed.

        Parameters
        ----------
        job_id : str
            Its id.
        problem : dict
            The problem body that says why.

        Returns
        -------
        bool
            False where the job was deleted or has ended already.
        """
        return self._end(job_id, status=FAILED, problem=problem)

    def cancel(self, job_id: str) -> bool:
        """Mark a job as cancelled; its row stays.

        Parameters
        ----------
        job_id : str
            Its id.

        Returns
        -------
        bool
            False where the job was deleted or has ended already.
        """
        return self._end(job_id, status=CANCELLED)

    def _end(self, job_id: str, **values: Any) -> bool:
        table = JOBS[kind_of(job_id)]
        place = self._place(job_id)
        values["bytes"] = self.vault.size(self._key(place), place) if values["status"] == DONE else 0
        with self._sessions.begin() as session:
            at_work = table.status.in_([QUEUED, RUNNING])
            ended = update(table).where(table.id == job_id, at_work).values(finished_at=_now(), **values)
            return bool(session.execute(ended).rowcount)  # type: ignore[attr-defined]

    def load_lattice(self, costmap_id: str) -> CostLattice:
        """Load the lattice of a cost map.

        Parameters
        ----------
        costmap_id : str
            Id of a cost map that is done.

        Returns
        -------
        CostLattice
            In memory.
        """
        return load_lattice(self.here(self.lattice_path(costmap_id)))

    def delete_costmap(self, costmap_id: str) -> None:
        """Delete a cost map: the row first, so that a job that still makes it stops.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        self._delete(self.costmap(costmap_id))
        LatticeFolder(self.lattice_path(costmap_id)).discard()
        self._remove_all(costmap_id)

    def hidden_models(self) -> set[str]:
        """Return the models that the caller must not see.

        Returns
        -------
        set of str
            Ids of the calibrations that others own.
        """
        if self._caller.sees_all:
            return set()
        with self._sessions() as session:
            ids = select(CalibrationRow.id)
            return set(session.scalars(ids)) - set(session.scalars(self._caller.own(ids, CalibrationRow)))

    def delete_calibration(self, calibration_id: str) -> None:
        """Delete the row of a calibration; its files are the caller's to delete.

        Parameters
        ----------
        calibration_id : str
            Its id.

        Raises
        ------
        NotFoundError
            If there is none.
        ConflictError
            If cost maps use its model; their ids are in the context.
        """
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
            session.delete(row)

    def tidy(self, job_id: str) -> None:
        """Remove what was only needed to make a job that is done.

        Parameters
        ----------
        job_id : str
            Its id.
        """
        self._remove_all(job_id, but=self._place(job_id))

    def discard(self, job_id: str, models_dir: Path) -> None:
        """Remove all files of a job.

        Parameters
        ----------
        job_id : str
            Its id.
        models_dir : Path
            Folder of trained models, where that of a calibration is.
        """
        LatticeFolder(self.lattice_path(job_id)).discard()
        self._remove_all(job_id)
        if kind_of(job_id) == CALIBRATION:
            shutil.rmtree(models_dir / job_id, ignore_errors=True)
            with contextlib.suppress(OSError):
                self.vault.remove(f"models/{job_id}")

    def _remove_all(self, job_id: str, but: Path | None = None) -> None:
        made = self._place(job_id)
        folder = made.parent
        for place in (folder / job_id, *folder.glob(f"{job_id}.*")):
            if place != but:
                shutil.rmtree(place, ignore_errors=True)
        self._forget(made.with_name(f"{made.name}.tiles"))
        if made != but:
            self._forget(made)

    def lattice_path(self, costmap_id: str) -> Path:
        """Return the folder of a cost map's lattice.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Returns
        -------
        Path
            Whether it exists or not.
        """
        return self._dir / "costmaps" / f"{costmap_id}.zarr"

    def calibration_folder(self, calibration_id: str) -> Path:
        """Return the folder of a calibration's report.

        Parameters
        ----------
        calibration_id : str
            Its id.

        Returns
        -------
        Path
            Of report.json and report.html, whether it exists or not.
        """
        return self._dir / "calibrations" / calibration_id

    def heightmap_path(self, heightmap_id: str) -> Path:
        """Return the file of a heightmap.

        Parameters
        ----------
        heightmap_id : str
            Its id.

        Returns
        -------
        Path
            Of a GeoTIFF, whether it exists or not.
        """
        return self._dir / "heightmaps" / f"{heightmap_id}.tif"

    def _place(self, job_id: str) -> Path:
        return self.lattice_path(job_id) if kind_of(job_id) == COSTMAP else self.calibration_folder(job_id)

    def runs_folder(self, runs_id: str) -> Path:
        """Return the folder of runs that were sent together.

        Parameters
        ----------
        runs_id : str
            Their id.

        Returns
        -------
        Path
            Of a file for each, whether it exists or not.
        """
        return self._dir / "runs" / runs_id

    def _row(self, table: type[Row], there: str, **key: str) -> Row:
        ((name, row_id),) = key.items()
        with self._sessions() as session:
            row = session.get(table, row_id)
        if row is None or not self._caller.may_see(row):
            raise NotFoundError(f"there {there} {row_id[:80]!r}", **{name: row_id[:80]})
        return row

    def _page(self, table: type[Any], limit: int, offset: int) -> tuple[list[Any], int]:
        with self._sessions() as session:
            own = self._caller.own
            total = session.scalar(own(select(func.count()).select_from(table), table)) or 0
            query = own(select(table), table).order_by(table.created_at.desc(), table.id).limit(limit).offset(offset)
            return list(session.scalars(query)), total


def safe_name(name: str) -> str:
    """Return a name that a file of the data directory may have.

    Parameters
    ----------
    name : str
        As the sender calls it.

    Returns
    -------
    str
        Letters, digits, dots, hyphens and underscores; at most 100.
    """
    return _UNSAFE.sub("_", name).lstrip(".")[-100:] or "run"


def _sources(row: Any) -> list[tuple[Any, list[str]]]:
    """What a job is made from, by table."""
    if isinstance(row, CalibrationRow):
        asked = row.request
        runs = [*asked["runs"], *asked.get("base_runs", []), *named_test_runs(asked)]
        return [(RunsRow, runs), (HeightmapRow, [row.heightmap_id])]
    return [(HeightmapRow, [row.heightmap_id])] if isinstance(row, CostmapRow) else []


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
