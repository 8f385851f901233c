"""Files and folders that are kept: how much space they take, their checksums, and how they go."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
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
