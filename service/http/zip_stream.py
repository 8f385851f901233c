"""Sends a folder as a zip archive, chunk by chunk, without a second copy on disk or in memory."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path


class _Sink(io.RawIOBase):
    """A file that cannot seek; what was written waits in `take`."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._written = 0

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        part = bytes(data)  # type: ignore[call-overload]
        self._parts.append(part)
        self._written += len(part)
        return len(part)

    def tell(self) -> int:
        return self._written

    def take(self) -> bytes:
        parts, self._parts = self._parts, []
        return b"".join(parts)


def zip_folder(folder: Path) -> Iterator[bytes]:
    """Return a folder as a zip archive, chunk by chunk.

    Files are stored, not compressed: the chunks of a lattice are compressed already.
    """
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(folder.parent))
            yield sink.take()
    yield sink.take()
