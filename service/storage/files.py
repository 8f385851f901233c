"""Files and folders that are kept: their space, their checksums, how they go, and that no other account reads them."""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path


def bytes_of(place: Path) -> int:
    """Return the size of a file, or of all files in a folder. What disappears meanwhile does not count."""
    if not place.is_dir():
        return place.stat().st_size if place.exists() else 0
    total = 0
    for folder, _, names in os.walk(place):  # passes over a folder that disappears, at which `Path.rglob` ends
        for name in names:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total


def remove(place: Path) -> None:
    """Remove a file or a folder, where it is there."""
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        place.unlink(missing_ok=True)


MODEL_SUMS = "model.sums.json"
"""File beside the report of a calibration, with the checksums of its model, which lies in the folder of models."""


def sums_of(place: Path) -> dict[str, str]:
    """Return the checksums of a file, or of a folder part by part.

    Result: SHA-256 by the name of each file or folder within it; of a folder, of the names and contents of all its
    files.
    """
    parts = sorted(place.iterdir()) if place.is_dir() else [place]
    return {"" if part == place else part.name: _sum_of(part) for part in parts}


def changed(place: Path, kept: Mapping[str, str]) -> Iterator[Path]:
    """Yield the parts that are not what was kept. A file or folder that has another content, or is not there."""
    for name, kept_sum in kept.items():
        part = place / name if name else place
        if not part.exists() or _sum_of(part) != kept_sum:
            yield part


def _sum_of(part: Path) -> str:
    if not part.is_dir():
        with part.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    whole = hashlib.sha256()
    for file in sorted(path for path in part.rglob("*") if path.is_file()):
        whole.update(f"{file.relative_to(part).as_posix()}\0{_sum_of(file)}\n".encode())
    return whole.hexdigest()


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
