"""Jobs that are kept, which are cost maps and calibrations, with their ends and files; and drives that are followed."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from pathlib import Path
from typing import Any

from sqlalchemy import bindparam, delete, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import defer

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.planner.lattice import CostLattice, checksums
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.storage.files import sums_of
from joulemap.service.storage.kept import Kept
from joulemap.service.storage.tables import (
    CALIBRATION,
    CANCELLED,
    COSTMAP,
    DONE,
    DRIVE,
    FAILED,
    JOBS,
    QUEUED,
    RUNNING,
    CalibrationRow,
    CostmapRow,
    DriveRow,
    kind_of,
    now,
)
from joulemap.service.storage.vault import FETCHED, ObjectVault


class KeptJobs(Kept):
    """Rows of jobs, and what was made."""

    def status(self, job_id: str) -> str | None:
        """Return the status of a job. Result: None where there is no such job."""
        table = JOBS[kind_of(job_id)]
        with self._sessions() as session:
            return session.scalar(select(table.status).where(table.id == job_id))

    def unfinished(self, kind: str = COSTMAP) -> list[str]:
        """Return the ids of jobs that wait or run, oldest first."""
        table = JOBS[kind]
        with self._sessions() as session:
            query = select(table.id).where(table.status.in_([QUEUED, RUNNING]))
            return list(session.scalars(query.order_by(table.created_at)))

    def wanted(self) -> dict[str, str | None]:
        """Return all jobs that wait or run, oldest first. Result: the owner of each, by its id."""
        found: list[Any] = []
        with self._sessions() as session:
            for table in JOBS.values():
                query = select(table.created_at, table.id, table.owner).where(table.status.in_([QUEUED, RUNNING]))
                found += session.execute(query)
        return {job_id: owner for _, job_id, owner in sorted(found, key=lambda row: row[:2])}

    def begin(self, costmap_id: str) -> None:
        """Make the folder of notes, or its record in an object store, without which nothing is written of a cost map.

        Raises NotFoundError if it was deleted, or has ended.
        """
        folder = LatticeFolder(self.lattice_path(costmap_id))
        if isinstance(self.vault, ObjectVault):
            self.vault.begin(self._key(folder.notes))
        else:
            folder.begin()
        if self.status(costmap_id) not in (QUEUED, RUNNING):  # since then: who deletes it looks for the folder later
            self._forget(folder.notes)
            raise NotFoundError(f"nobody waits for cost map {costmap_id} any more", costmap_id=costmap_id)

    def report(self, job_id: str, progress: float) -> None:
        """Note how far a job is."""
        table = JOBS[kind_of(job_id)]
        with self._sessions.begin() as session:
            at_work = update(table).where(table.id == job_id, table.status.in_([QUEUED, RUNNING]))
            session.execute(at_work.values(status=RUNNING, progress=progress))

    def finish(self, job_id: str, summary: dict[str, Any]) -> bool:
        """Mark a job as done."""
        return self._end(job_id, status=DONE, progress=1.0, summary=summary)

    def fail(self, job_id: str, problem: dict[str, Any]) -> bool:
        """Mark a job as failed. Result: False where the job was deleted or has ended already."""
        return self._end(job_id, status=FAILED, problem=problem)

    def cancel(self, job_id: str) -> bool:
        """Mark a job as cancelled; its row stays. Result: False where the job was deleted or has ended already."""
        return self._end(job_id, status=CANCELLED)

    def _end(self, job_id: str, **values: Any) -> bool:
        table = JOBS[kind_of(job_id)]
        place = self._place(job_id)
        done = values["status"] == DONE
        values["bytes"] = self.vault.size(self._key(place), place) if done else 0
        values["sums"] = None
        if done and not isinstance(self.vault, ObjectVault):
            with contextlib.suppress(FileNotFoundError):  # it was deleted meanwhile, and its row with it
                values["sums"] = sums_of(place)
        with self._sessions.begin() as session:
            at_work = table.status.in_([QUEUED, RUNNING])
            ended = update(table).where(table.id == job_id, at_work).values(finished_at=now(), **values)
            return bool(session.execute(ended).rowcount)  # type: ignore[attr-defined]

    def tidy(self, job_id: str) -> None:
        """Remove what was only needed to make a job that is done."""
        self._remove_all(job_id, but=self._place(job_id))

    def discard(self, job_id: str, models_dir: Path) -> None:
        """Remove all files of a job."""
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
            asked_for = but is not None and place.name.endswith(FETCHED)  # by who saw first that the job is done
            if place != but and not asked_for:
                shutil.rmtree(place, ignore_errors=True)
        self._forget(LatticeFolder(made).notes)
        if made != but:
            self._forget(made)

    def lattice_path(self, costmap_id: str) -> Path:
        """Return the folder of a cost map's lattice."""
        return self.path(CostmapRow, costmap_id)

    def _place(self, job_id: str) -> Path:
        return self.path(JOBS[kind_of(job_id)], job_id)

    def _add(self, row: Any, size: int = 0) -> Any:
        try:
            self._keep(row, size)
        except IntegrityError as error:
            raise NotFoundError(f"there is no heightmap {row.heightmap_id!r}", heightmap_id=row.heightmap_id) from error
        return row

    def add_costmap(self, heightmap_id: str, request: dict[str, Any], *, most_bytes: int = 0) -> CostmapRow:
        """Add a cost map to the queue. Raises NotFoundError if the heightmap was deleted."""
        return self._add(CostmapRow(**new_job(COSTMAP, heightmap_id, request)), most_bytes)

    def costmap(self, costmap_id: str) -> CostmapRow:
        """Return the row of a cost map. Raises NotFoundError if there is none."""
        return self._row(CostmapRow, "is no cost map", costmap_id=costmap_id)

    def alike(self, row: CostmapRow) -> list[str]:
        """Return the newest finished cost map of every other model that differs from one in nothing but the model."""

        def _but_model(request: dict[str, Any]) -> dict[str, Any]:
            return {key: value for key, value in request.items() if key != "model"}

        newest: dict[str, str] = {}
        with self._sessions() as session:
            query = select(CostmapRow).where(CostmapRow.heightmap_id == row.heightmap_id, CostmapRow.status == DONE)
            for made in session.scalars(query.order_by(CostmapRow.created_at)):
                if _but_model(made.request) == _but_model(row.request):
                    newest[made.request["model"]] = made.id
        newest.pop(row.request["model"], None)
        return list(newest.values())

    def load_lattice(self, costmap_id: str) -> CostLattice:
        """Load the lattice of a cost map."""
        return load_lattice(self.lattice_folder(costmap_id))

    def lattice_folder(self, costmap_id: str) -> Path:
        """Return the folder of a cost map for reading.

        One of an older version has no checksums of its own: it is compared with those of its row, once.

        Raises DamagedError if it is not what was kept.
        """
        place = self.here(self.lattice_path(costmap_id))
        if place.exists() and not (place / checksums.FILE).exists():
            self.intact(CostmapRow, costmap_id, place)
        return place

    def delete_costmap(self, costmap_id: str) -> None:
        """Delete a cost map: the row first, so that a job that still makes it stops.

        Raises NotFoundError if there is none.
        """
        row = self.costmap(costmap_id)
        self._delete(lambda session: session.delete(row))
        LatticeFolder(self.lattice_path(costmap_id)).discard()
        self._remove_all(costmap_id)

    def add_calibration(self, heightmap_id: str | None, request: dict[str, Any]) -> CalibrationRow:
        """Add a calibration to the queue.

        `heightmap_id`: id of the heightmap that the runs were driven on, None for runs without positions. Raises
        NotFoundError if the heightmap was deleted.
        """
        return self._add(CalibrationRow(**new_job(CALIBRATION, heightmap_id, request)))

    def calibration(self, calibration_id: str) -> CalibrationRow:
        """Return the row of a calibration. Raises NotFoundError if there is none."""
        return self._row(CalibrationRow, "is no calibration", calibration_id=calibration_id)

    def hidden_models(self) -> set[str]:
        """Return the models that the caller must not see. Result: ids of the calibrations that others own."""
        if self._caller.sees_all:
            return set()
        with self._sessions() as session:
            ids = select(CalibrationRow.id)
            return set(session.scalars(ids)) - set(session.scalars(self._caller.own(ids, CalibrationRow)))

    def delete_calibration(self, calibration_id: str) -> None:
        """Delete the row of a calibration; its files are the caller's to delete.

        Raises NotFoundError if there is none; ConflictError if cost maps use its model; their ids are in the context.
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
        self._delete(lambda session: session.delete(row))


def new_job(kind: str, heightmap_id: str | None, request: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a job that waits."""
    return {
        "id": f"{kind}-{secrets.token_hex(6)}",
        "created_at": now(),
        "heightmap_id": heightmap_id,
        "request": request,
        "status": QUEUED,
        "progress": 0.0,
    }


MOST_DRIVES = 1000
"""Of one owner; the oldest ones make room."""
_NOTED = (
    update(DriveRow)
    .where(DriveRow.id == bindparam("of"), DriveRow.updates == bindparam("known"))
    .values({"updates": DriveRow.updates + 1, **{name: bindparam(name) for name in ("state", "forecast", "unused")}})
)
_LONG = defer(DriveRow.request), defer(DriveRow.state)


class KeptDrives(Kept):
    """Rows of drives, each with all that is known of it."""

    def add_drive(
        self, costmap_id: str, request: dict[str, Any], state: dict[str, Any], forecast: dict[str, Any]
    ) -> DriveRow:
        """Add a drive over a cost map; the oldest of its owner are deleted beyond `MOST_DRIVES`."""
        row = DriveRow(
            id=f"{DRIVE}-{secrets.token_hex(6)}",
            created_at=now(),
            owner=self._caller.name,
            costmap_id=costmap_id,
            request=request,
            updates=0,
            unused=0,
            state=state,
            forecast=forecast,
        )
        with self._adding, self._sessions.begin() as session:
            its = select(DriveRow.id).where(DriveRow.owner == row.owner)
            older = session.scalars(its.order_by(DriveRow.created_at.desc()).offset(MOST_DRIVES - 1)).all()
            if older:
                session.execute(delete(DriveRow).where(DriveRow.id.in_(older)))
            session.add(row)
        return row

    def drive(self, drive_id: str, *, whole: bool = True) -> DriveRow:
        """Return the row of a drive; if it need not be whole, without route, state and forecast, which take longer to
        read than all else of an update. Raises NotFoundError if there is none.
        """
        options = () if whole else (*_LONG, defer(DriveRow.forecast))
        return self._row(DriveRow, "is no drive", *options, drive_id=drive_id)

    def drives(self, *, limit: int, offset: int, costmap_id: str | None = None) -> tuple[list[DriveRow], int]:
        """Return one page of the drives, newest first, without routes and states, and how many there are in all."""
        over = [] if costmap_id is None else [DriveRow.costmap_id == costmap_id]
        return self.page(DriveRow, limit, offset, *_LONG, where=over)

    def note_drive(self, row: DriveRow, state: dict[str, Any], forecast: dict[str, Any], unused: int) -> bool:
        """Replace what is known of a drive. Result: False, and nothing is replaced, where it has changed since."""
        values = {"of": row.id, "known": row.updates, "state": state, "forecast": forecast, "unused": unused}
        # in turn: SQLite has one writer, and others look again only after up to 0.1 s
        with self._adding, self.engine.begin() as connection:
            return bool(connection.execute(_NOTED, values).rowcount)

    def delete_drive(self, drive_id: str) -> None:
        """Delete a drive. Raises NotFoundError if there is none."""
        row = self.drive(drive_id)
        with self._sessions.begin() as session:
            session.execute(delete(DriveRow).where(DriveRow.id == row.id))
