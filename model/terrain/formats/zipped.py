"""The file in a zip or a gzip: bounded, and never written to disk."""

from __future__ import annotations

import gzip
import lzma
import struct
import zipfile
import zlib
from dataclasses import replace
from pathlib import PurePosixPath
from typing import IO

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.source_file import SourceFile

MAX_UNPACKED_BYTES = 128 << 20
"""Most bytes that are unpacked from one archive that was sent."""

MAX_OWN_BYTES = 2 << 30
"""The same of an archive of the user who runs joulemap."""

_HEAD_BYTES = 512
_SIDE = (".hdr", ".prj", ".sgrd", ".rdc", ".gri", ".aux.xml", ".tfw", ".pgw", ".wld", ".stx", ".blw")
_ARCHIVES = (b"PK\x03\x04", b"PK\x05\x06", b"\x1f\x8b")
_MOST_MEMBERS = 1_000
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    KeyError,
    ValueError,
)


def unpacked(source: SourceFile, suffixes: tuple[str, ...]) -> SourceFile:
    """Return the file in an archive; any other file, and an archive of NumPy arrays, as it is.

    Result: its content in memory, with the files that belong to it.
    """
    try:
        if source.head.startswith(_ARCHIVES[2]):
            with source.open() as stream, gzip.GzipFile(fileobj=stream) as packed:
                content = _bounded(packed, source.name, _limit(source))
            return SourceFile(content, source.name.removesuffix(".gz"), content[:_HEAD_BYTES], alone=True)
        if not source.head.startswith(_ARCHIVES[:2]):
            return source
        with source.open() as stream, zipfile.ZipFile(stream) as archive:
            return _member(archive, source, suffixes)
    except _BROKEN as error:
        raise HeightmapError(f"{source.name} is truncated or corrupt: {str(error)[:200]}") from error


def _member(archive: zipfile.ZipFile, source: SourceFile, suffixes: tuple[str, ...]) -> SourceFile:
    inside = [each for each in archive.infolist() if each.filename and not each.is_dir() and not _hidden(each.filename)]
    if len(inside) > _MOST_MEMBERS:
        raise TooLargeError(f"{source.name} holds {len(inside):,} files; the limit is {_MOST_MEMBERS:,}")
    if not inside or any(each.filename.endswith(".npy") for each in inside):
        return source
    maps = [each for each in inside if each.filename.lower().endswith(suffixes)] if len(inside) > 1 else inside
    for better in (_not_a_preview, _is_arc_grid):
        maps = [each for each in maps if better(each.filename)] or maps
    if len(maps) != 1:
        names = ", ".join(each.filename for each in inside)[:300]
        raise HeightmapError(
            f"{source.name} must hold one heightmap, and holds {len(maps)} (it has {names}): take one out"
        )
    (found,) = maps
    left, contents = _limit(source), list[tuple[str, bytes]]()
    stem = PurePosixPath(found.filename).stem.lower()
    beside = [
        each
        for each in inside
        if each is not found
        and (
            _is_arc_grid(found.filename)
            or (PurePosixPath(each.filename).name.lower().startswith(stem) and each.filename.lower().endswith(_SIDE))
        )
    ]
    for each in (found, *beside):
        with archive.open(each) as stream:
            content = _bounded(stream, source.name, left)
        left -= len(content)
        contents.append((PurePosixPath(each.filename).name, content))
    (name, content), *others = contents
    if content.startswith(_ARCHIVES) and not name.lower().endswith(".npz"):
        raise HeightmapError(f"{source.name} holds another archive, {name[:80]}: unpack it")
    return replace(source, place=content, name=name, head=content[:_HEAD_BYTES], alone=True, beside=tuple(others))


def _limit(source: SourceFile) -> int:
    return MAX_UNPACKED_BYTES if source.alone else MAX_OWN_BYTES


def _not_a_preview(name: str) -> bool:
    return not name.lower().endswith((".jpg", ".jpeg", ".png", ".webp"))


def _is_arc_grid(name: str) -> bool:
    """Whether it is the file of an ArcInfo grid that holds its heights; what it needs lies in the same folder."""
    return PurePosixPath(name).name.lower() == "w001001.adf"


def _bounded(stream: IO[bytes] | gzip.GzipFile, name: str, limit: int) -> bytes:
    """All of a stream. Raises TooLargeError as soon as it is longer than the limit."""
    content = stream.read(limit + 1)
    if len(content) > limit:
        raise TooLargeError(
            f"{name} unpacks to more than {limit:,} bytes: unpack it, and give the file that is in it", limit=limit
        )
    return content


def _hidden(name: str) -> bool:
    return any(part.startswith((".", "__MACOSX")) for part in PurePosixPath(name).parts)
