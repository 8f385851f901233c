"""What is kept is for the account of the service alone: others on the machine cannot read it."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER_MODE, FILE_MODE = 0o700, 0o600
_OTHERS = 0o077
_LOG = logging.getLogger("joulemap.service")


def others_get_nothing() -> None:
    """Make every file and folder of this process, and of those that it starts, for its account alone from now on."""
    os.umask(_OTHERS)


@contextmanager
def private_files() -> Iterator[None]:
    """Make the files and folders of a block for this account alone."""
    before = os.umask(_OTHERS)
    try:
        yield
    finally:
        os.umask(before)


def close_database(file: Path) -> None:
    """Let nobody else read a SQLite database, which holds the hashes of keys; it is made where there is none."""
    with suppress(OSError):  # it is there; or it cannot be made, which SQLite will say
        os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, FILE_MODE))
    for path in (file, *(file.with_name(f"{file.name}-{end}") for end in ("wal", "shm", "journal"))):
        mode = path.stat().st_mode & 0o777 if path.is_file() else 0
        if mode & _OTHERS:
            _close(path, mode)


def _close(path: Path, mode: int) -> None:
    try:
        path.chmod(mode & ~_OTHERS)
    except OSError:  # it belongs to another account, which has to do it
        _LOG.warning("%s is open to other accounts (mode %04o): chmod go-rwx %s", path, mode, path)
    else:
        _LOG.warning("%s was open to other accounts (mode %04o) and is no more: it holds hashes of keys", path, mode)


def say_what_is_open(folder: Path) -> None:
    """Say where other accounts can look into a data directory, and how that ends."""
    mode = folder.stat().st_mode & 0o777
    if mode & _OTHERS:
        words = "the data directory %s is open to other accounts (mode %04o): chmod -R go-rwx %s"
        _LOG.warning(words, folder, mode, folder)
