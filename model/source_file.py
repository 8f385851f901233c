"""A file that is to be read, on disk or in memory, whatever it holds."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO


@dataclass(frozen=True)
class SourceFile:
    """A file that is to be read, on disk or in memory.

    Attributes
    ----------
    place : Path or bytes
        Where the file is, or all its bytes.
    name : str
        What messages call it.
    head : bytes
        Its first 512 bytes, fewer where it is shorter.
    alone : bool
        Whether no other file may be opened with it, because somebody else sent it. Bytes are always alone.
    beside : tuple of (str, bytes)
        Name and content of the files that came with it, in a zip.
    """

    place: Path | bytes
    name: str
    head: bytes
    alone: bool = False
    beside: tuple[tuple[str, bytes], ...] = ()

    @property
    def size_bytes(self) -> int:
        """Length of the whole file [bytes]."""
        return len(self.place) if isinstance(self.place, bytes) else self.place.stat().st_size

    def open(self) -> BinaryIO:
        """Return a new binary stream at the start of the file; the caller closes it."""
        return io.BytesIO(self.place) if isinstance(self.place, bytes) else self.place.open("rb")
