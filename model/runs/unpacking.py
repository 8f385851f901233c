"""Logs that are packed one by one: gzip, and a zip of one file."""

from __future__ import annotations

import gzip
import zipfile
import zlib
from pathlib import PurePath
from typing import IO

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.source_file import SourceFile

_HEAD_BYTES = 512
_LARGEST_RATIO = 200  # of a text of numbers; it packs to a third or a tenth
_ALWAYS_BYTES = 1 << 24
_LARGEST_BYTES = 1 << 32
_BAG_PARTS = (".mcap", ".db3", ".zstd", ".yaml")


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
                if any(name.lower().endswith(_BAG_PARTS) for name in names):
                    return source
                if "[Content_Types].xml" in names:
                    raise RunsError(f"run {source.name} is a spreadsheet: save the sheet as CSV", run=source.name)
                if len(files) != 1:
                    listed = ", ".join(names[:5])[:200] or "nothing"
                    raise RunsError(f"run {source.name} holds {listed}: unpack it, and give one log", run=source.name)
                with archive.open(files[0]) as inside:
                    return _read(source, inside, names[0])
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise RunsError(f"run {source.name}: not a readable archive: {str(error)[:200]}", run=source.name) from error


def _read(source: SourceFile, stream: IO[bytes] | gzip.GzipFile, name: str) -> SourceFile:
    most = min(_LARGEST_RATIO * source.size_bytes + _ALWAYS_BYTES, _LARGEST_BYTES)
    content = stream.read(most + 1)
    if len(content) > most:
        raise TooLargeError(
            f"run {source.name} unpacks to more than {most:,} bytes", run=source.name, bytes=len(content), limit=most
        )
    return SourceFile(content, name, content[:_HEAD_BYTES])
