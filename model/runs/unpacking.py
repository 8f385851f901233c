"""Logs that are packed: gzip, and a zip of one file or of the tables of one recording."""

from __future__ import annotations

import gzip
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import IO

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.source_file import SourceFile

_HEAD_BYTES = 512
_LARGEST_RATIO = 200  # of a text of numbers; it packs to a third or a tenth
_ALWAYS_BYTES = 1 << 24
_LARGEST_BYTES = 1 << 32
MOST_TABLES = 100
"""Of one recording: it has no more topics that a run needs."""
_ARRAYS_OR_BAG = (".npy", ".mcap", ".db3", ".zstd", "metadata.yaml")


def unpacked(source: SourceFile) -> SourceFile:
    """Return what a packed log holds."""
    packed = source.head.startswith(b"\x1f\x8b") and not source.name.lower().endswith((".tar.gz", ".tgz"))
    if not packed and not source.head.startswith(b"PK\x03\x04"):
        return source
    try:
        with source.open() as stream:
            if packed:
                return _read(source, gzip.GzipFile(fileobj=stream), source.name.removesuffix(".gz"))
            with zipfile.ZipFile(stream) as archive:
                files = [member for member in archive.infolist() if not member.is_dir()]
                names = [PurePath(member.filename).name for member in files]
                if any(name.lower().endswith(_ARRAYS_OR_BAG) for name in names):
                    return source
                if "[Content_Types].xml" in names:
                    raise RunsError.of_run(source.name, " is a spreadsheet: save the sheet as CSV")
                if not 0 < len(files) <= MOST_TABLES:
                    listed = ", ".join(names[:5])[:200] or "nothing"
                    raise RunsError.of_run(source.name, f" holds {listed}: unpack it, and give one log")
                if len(set(names)) < len(names):
                    raise RunsError.of_run(
                        source.name, " holds several files of the same name: unpack it, and give each log alone"
                    )
                first, *rest = _all(source, archive, files)
                return replace(first, beside=tuple((each.name, bytes(each.place)) for each in rest))
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise RunsError.of_run(source.name, f"not a readable archive: {str(error)[:200]}") from error


def _all(source: SourceFile, archive: zipfile.ZipFile, files: Sequence[zipfile.ZipInfo]) -> list[SourceFile]:
    found = list[SourceFile]()
    for member in files:
        with archive.open(member) as inside:
            found.append(_read(source, inside, PurePath(member.filename).name, sum(each.size_bytes for each in found)))
    return found


def _read(source: SourceFile, stream: IO[bytes] | gzip.GzipFile, name: str, before: int = 0) -> SourceFile:
    most = min(_LARGEST_RATIO * source.size_bytes + _ALWAYS_BYTES, _LARGEST_BYTES)
    content = stream.read(most - before + 1)
    if len(content) + before > most:
        raise TooLargeError.of_run(source.name, f" unpacks to more than {most:,} bytes", bytes=len(content), limit=most)
    return SourceFile(content, name, content[:_HEAD_BYTES])
