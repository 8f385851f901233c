"""The locks of a data folder and what lies in it for nothing: several services use it, or one that is alone."""

from __future__ import annotations

import fcntl
import secrets
import shutil
import time
from pathlib import Path
from typing import IO, Any

from sqlalchemy import select
from sqlalchemy.orm import Session, sessionmaker

from joulemap.model.errors import ConflictError
from joulemap.service.storage.files import remove
from joulemap.service.storage.private import FOLDER_MODE
from joulemap.service.storage.tables import JOBS, QUEUED, RUNNING

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
