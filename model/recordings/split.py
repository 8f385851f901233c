"""ROS 2 bags of several files: their folder, or an archive of it (.zip, .tar, .tar.gz)."""

from __future__ import annotations

import re
import shutil
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO

from joulemap.model.errors import InputError, TooLargeError
from joulemap.model.source_file import SourceFile

METADATA = "metadata.yaml"
"""The file in the folder of a ROS 2 bag that names the others."""

_MARK = b"rosbag2_bagfile_information"
_ZIP, _GZIP, _TAR, _TAR_AT = b"PK\x03\x04", b"\x1f\x8b", b"ustar", 257
_SUFFIXES = (".mcap", ".db3", ".bag")
_COMPRESSED = (".zstd", ".zst", ".lz4", ".gz")
_HEAD_BYTES = 512
_MOST_PARTS = 1_000
_LARGEST_RATIO, _ALWAYS_BYTES, _LARGEST_BYTES = 50, 10_000_000, 4_000_000_000


def is_split(place: Path) -> bool:
    """Decide whether a folder is a ROS 2 bag. Result: True where its metadata.yaml says so."""
    return place.is_dir() and (place / METADATA).is_file() and head_of(place).startswith(_MARK)


def head_of(place: Path) -> bytes:
    """Return the first bytes by which a recording is recognised.

    Result: of the file, or of the folder's metadata.yaml; 512 at most.
    """
    with (place / METADATA if place.is_dir() else place).open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of an archive, or by the first line of the folder's metadata.yaml.

    Result: True where `parts_of` is to look for the bag's files.
    """
    packed = head.startswith(_GZIP) and name.lower().endswith((".tar.gz", ".tgz"))
    return head.startswith((_MARK, _ZIP)) or head[_TAR_AT:].startswith(_TAR) or packed


@contextmanager
def parts_of(source: SourceFile) -> Iterator[list[SourceFile]]:
    """Give the files of a bag. What an archive was unpacked to is gone afterwards."""
    if source.head.startswith(_MARK):
        if not isinstance(source.place, Path):
            raise InputError(
                f"{source.name} is the metadata.yaml of a ROS 2 bag and holds no message: send the folder with its "
                ".db3 or .mcap files as one .zip"
            )
        folder = source.place if source.place.is_dir() else source.place.parent
        yield _ordered(source.name, ((path.name, path) for path in folder.iterdir() if path.is_file()))
        return
    with tempfile.TemporaryDirectory() as name, source.open() as stream:
        unpack = _unzipped if source.head.startswith(_ZIP) else _untarred
        yield _ordered(source.name, unpack(source, stream, Path(name)))


def _ordered(name: str, found: Iterable[tuple[str, Path]]) -> list[SourceFile]:
    files = sorted(found, key=lambda each: [int(part) if part.isdigit() else 0 for part in re.split(r"(\d+)", each[0])])
    parts = [SourceFile(path, f"{name}/{inside}", head_of(path)) for inside, path in files if _is_part(inside)]
    if parts:
        return parts
    packed = next((inside for inside, _ in files if inside.lower().endswith(_COMPRESSED)), None)
    if packed is not None:
        raise InputError(
            f"{name}: its file {packed[:80]} is compressed: unpack it (`zstd -d {packed[:80]}`), or write the bag "
            "again with `ros2 bag convert`, without compression_mode",
            file=packed[:80],
        )
    there = ", ".join(inside for inside, _ in files[:5])[:200] or "nothing"
    raise InputError(f"{name} holds no {', '.join(_SUFFIXES)} file: it holds {there}", name=name)


def _is_part(inside: str) -> bool:
    return inside.lower().endswith(_SUFFIXES)


class _Room:
    """How much an archive may unpack to, and how many files it may hold."""

    def __init__(self, source: SourceFile) -> None:
        self._name = source.name
        self._limit = min(_LARGEST_RATIO * source.size_bytes + _ALWAYS_BYTES, _LARGEST_BYTES)
        self._taken = self._count = 0

    def take(self, size: int) -> None:
        """Count a file before it is unpacked."""
        self._taken += size
        self._count += 1
        if self._taken > self._limit or self._count > _MOST_PARTS:
            raise TooLargeError(
                f"{self._name} unpacks to {self._count:,} files of {self._taken:,} bytes or more, the limits are "
                f"{_MOST_PARTS:,} and {self._limit:,}: send the parts of the bag one by one",
                bytes=self._taken,
                limit=self._limit,
            )


def _unzipped(source: SourceFile, stream: BinaryIO, folder: Path) -> Iterator[tuple[str, Path]]:
    room = _Room(source)
    with zipfile.ZipFile(stream) as archive:
        for number, member in enumerate(archive.infolist()):
            inside = Path(member.filename).name
            if member.is_dir() or not _is_part(inside):
                if inside.lower().endswith(_COMPRESSED):
                    yield inside, Path(source.name)
                continue
            room.take(member.file_size)
            with archive.open(member) as packed:
                yield inside, _copied(packed, folder / f"{number}{Path(inside).suffix}")


def _untarred(source: SourceFile, stream: BinaryIO, folder: Path) -> Iterator[tuple[str, Path]]:
    room = _Room(source)
    with tarfile.open(fileobj=stream, mode="r:*") as archive:
        for number, member in enumerate(archive):
            inside = Path(member.name).name
            room.take(member.size)
            packed = archive.extractfile(member) if member.isreg() else None
            if packed is not None and _is_part(inside):
                yield inside, _copied(packed, folder / f"{number}{Path(inside).suffix}")
            elif inside.lower().endswith(_COMPRESSED):
                yield inside, Path(source.name)


def _copied(packed: IO[bytes], place: Path) -> Path:
    with place.open("wb") as out:
        shutil.copyfileobj(packed, out)
    return place
