"""A data folder: its locks (of services and of jobs), what lies there for nothing, and room on its disk."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import struct
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from sqlalchemy import Connection, Engine, select, text
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import ConflictError, StorageFullError
from joulemap.service.storage.files import FOLDER_MODE, remove
from joulemap.service.storage.tables import JOBS, QUEUED, RUNNING

_RESERVE_BYTES = 4_000_000  # more than the database writes to delete a row
_STEP_BYTES = 1_000_000  # by which room is reserved for an upload that does not say how long it is


class Room:
    """The disk of a data folder, of which some stays free."""

    def __init__(self, folder: Path, *, least_free_bytes: int) -> None:
        self._folder, self._least = folder, least_free_bytes
        self._reserve = folder / "reserve"
        self.arriving: Counter[str | None] = Counter()
        """Bytes that are reserved for uploads on their way, by owner."""
        self.arrived = 0
        """Bytes of these uploads that are on the disk."""

    def check(self, promised_bytes: int) -> None:
        """Check that there is room for what may still come: of jobs (`promised_bytes`) and of uploads on their way."""
        to_come = promised_bytes + self.arriving.total() - self.arrived
        free = shutil.disk_usage(self._folder).free
        if free - to_come < self._least:
            raise StorageFullError(
                f"the disk is full: {free / 1e6:.0f} MB are free, this and other unfinished work take up to "
                f"{to_come / 1e6:.0f} MB, and {self._least / 1e6:.0f} MB must stay free (JOULEMAP_MIN_FREE_MB): delete "
                "what is not needed any more",
                free_bytes=free,
                to_come_bytes=to_come,
                least_free_bytes=self._least,
            )

    def keep_reserve(self) -> None:
        """Have a file that can be given up on a full disk, once there is room for it."""
        if not self._reserve.exists() and shutil.disk_usage(self._folder).free > self._least + 2 * _RESERVE_BYTES:
            with suppress(OSError):
                self._reserve.write_bytes(bytes(_RESERVE_BYTES))

    def make_a_little(self) -> bool:
        """Give up the reserve. Result: False where that does not help."""
        if shutil.disk_usage(self._folder).free > _RESERVE_BYTES or not self._reserve.exists():
            return False
        self._reserve.unlink(missing_ok=True)
        return True


class Upload:
    """An upload on its way; all uploads of a service are counted on its event loop."""

    def __init__(self, room: Room, owner: str | None) -> None:
        self._room, self._owner = room, owner
        self._reserved = self._arrived = 0

    def reserve(self, more_bytes: int) -> None:
        """Reserve room, before it is checked that there is some: of two uploads at a time one is refused."""
        self._reserved += more_bytes
        self._room.arriving[self._owner] += more_bytes

    def arrives(self, more_bytes: int) -> bool:
        """Count what goes to the disk now. Result: whether more had to be reserved for it, which is to be checked."""
        lacking = self._arrived + more_bytes - self._reserved
        if lacking > 0:
            self.reserve(max(lacking, _STEP_BYTES))
        self._arrived += more_bytes
        self._room.arrived += more_bytes
        return lacking > 0

    def end(self) -> None:
        """Count it no more: it is kept, or removed."""
        self._room.arrived -= self._arrived
        self._room.arriving[self._owner] -= self._reserved


FOLDERS = ("heightmaps", "costmaps", "runs", "calibrations", "uploads")
_WAIT_S = 30.0  # for a service that starts at the same moment


class DataFolder:
    """A data folder that this process uses, beside other services."""

    def __init__(self, path: Path) -> None:
        self.path, self.alone = path, False
        self.uploads = path / "uploads"
        self._locks: list[IO[str]] = []

    def make(self) -> None:
        """Make the folders that are missing, for this account alone."""
        self.path.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
        for name in FOLDERS:
            (self.path / name).mkdir(mode=FOLDER_MODE, exist_ok=True)

    def use(self, *, alone: bool) -> None:
        """Use the folder as a service. Raises ConflictError if another one does."""
        lock = (self.path / "lock").open("w")
        self._locks.append(lock)
        self.alone = _locked(lock, fcntl.LOCK_EX)
        deadline = time.monotonic() + _WAIT_S
        while not self.alone and (alone or not _locked(lock, fcntl.LOCK_SH)):
            if alone or time.monotonic() > deadline:
                self.leave()
                raise ConflictError(
                    f"another joulemap uses the data directory {self.path}: stop it, or set JOULEMAP_DATA_DIR",
                    data_dir=str(self.path),
                )
            time.sleep(0.05)
        name = secrets.token_hex(8)
        mine = (self.path / "uploads" / f"{name}.lock").open("w")
        fcntl.flock(mine, fcntl.LOCK_EX)
        self._locks.append(mine)
        self.uploads = self.path / "uploads" / name
        self.uploads.mkdir()

    def share(self) -> None:
        """Let other services use it too, from now on."""
        fcntl.flock(self._locks[0], fcntl.LOCK_SH)

    def leave(self) -> None:
        """Use it no more."""
        if self.uploads.parent != self.path:
            shutil.rmtree(self.uploads, ignore_errors=True)
            self.uploads.with_name(f"{self.uploads.name}.lock").unlink(missing_ok=True)
        for lock in self._locks:
            lock.close()
        self._locks.clear()

    def sweep(self, sessions: sessionmaker[Session]) -> list[Path]:
        """Remove what processes left unfinished that were killed; only where no other service uses the folder.

        What is whole stays, whether the database knows it or not: the database may be the wrong one.
        """
        if not self.alone:
            return []
        swept = self.leftovers(sessions)
        for path in swept:
            remove(path)
        return swept

    def leftovers(self, sessions: sessionmaker[Session]) -> list[Path]:
        """Return what processes left unfinished that were killed.

        Result: files and folders that no process works on.
        """
        at_work: set[str] = set()
        with sessions() as session:
            for table in JOBS.values():
                at_work |= set(session.scalars(select(table.id).where(table.status.in_([QUEUED, RUNNING]))))
        uploads = self.path / "uploads"
        in_use = {path.stem for path in uploads.glob("*.lock") if _is_held(path)}
        found = [path for path in sorted(uploads.iterdir()) if path.stem not in in_use]
        for kind in (*(f"{folder}/*.partial" for folder in FOLDERS if folder != "uploads"), "costmaps/*.tiles"):
            found += [path for path in self.path.glob(kind) if path.name.partition(".")[0] not in at_work]
        return found


def _locked(lock: IO[Any], how: int) -> bool:
    try:
        fcntl.flock(lock, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_held(path: Path) -> bool:
    with path.open("rb") as lock:
        return not _locked(lock, fcntl.LOCK_EX)


class Claims:
    """The jobs that one service has claimed: of two services on one database, one sends a job off.

    A claim is a lock that ends with its process, however that ends: nobody has to find out who is alive. With
    PostgreSQL it is an advisory lock of the database; with SQLite, which is for one machine, a byte of a file is
    locked. On Linux that lock is of the open file, so that two services of one process do not share it.
    """

    def __init__(self, engine: Engine, file: Path) -> None:
        self._engine, self._path = engine, file
        self._file: IO[bytes] | None = None
        self._connection: Connection | None = None  # whose locks are held as long as it is open
        self._held: set[str] = set()

    def keep(self, wanted: Iterable[str]) -> set[str]:
        """Claim all jobs that no other service has, and give back the others.

        Result: those that are claimed; what was claimed before is lost where the database was.
        """
        wanted = set(wanted)
        try:
            if self._engine.dialect.name != "postgresql":
                take, give = self._lock_byte, self._unlock_byte
            else:
                if self._connection is None:
                    self._connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
                self._connection.execute(text("select 1"))
                take, give = self._lock_number, self._unlock_number
            for job_id in self._held - wanted:
                give(_number(job_id))
                self._held.discard(job_id)
            self._held |= {job_id for job_id in wanted - self._held if take(_number(job_id))}
        except SQLAlchemyError:
            self.close()
            raise
        return set(self._held)

    def close(self) -> None:
        """Give all jobs back."""
        self._held.clear()
        if self._file is not None:
            self._file.close()
            self._file = None
        if self._connection is not None:
            with suppress(SQLAlchemyError):
                self._connection.invalidate()  # not back to the pool, with its locks
                self._connection.close()
            self._connection = None

    def _lock_byte(self, number: int) -> bool:
        if self._file is None:
            self._file = self._path.open("wb")
        try:
            self._set_lock(fcntl.F_WRLCK, number)
        except (BlockingIOError, PermissionError):
            return False
        return True

    def _unlock_byte(self, number: int) -> None:
        self._set_lock(fcntl.F_UNLCK, number)

    def _set_lock(self, kind: int, number: int) -> None:
        assert self._file is not None
        if hasattr(fcntl, "F_OFD_SETLK"):
            wanted = struct.pack("hhqqi", kind, os.SEEK_SET, number, 1, 0)  # struct flock of 64 bits
            fcntl.fcntl(self._file, fcntl.F_OFD_SETLK, wanted)
        else:
            how = fcntl.LOCK_UN if kind == fcntl.F_UNLCK else fcntl.LOCK_EX | fcntl.LOCK_NB
            fcntl.lockf(self._file, how, 1, number)

    def _lock_number(self, number: int) -> bool:
        assert self._connection is not None
        return bool(self._connection.scalar(text("select pg_try_advisory_lock(:number)"), {"number": number}))

    def _unlock_number(self, number: int) -> None:
        assert self._connection is not None
        self._connection.execute(text("select pg_advisory_unlock(:number)"), {"number": number})


def _number(job_id: str) -> int:
    """The random number of an id, which has 48 bits."""
    return int(job_id.rpartition("-")[2], 16)
