"""Checksums of the files of a cost map: what is read from disk is what was written, or it is an error.

The file `checksums` beside the arrays names every file of the folder, with its size and a CRC-32C of each piece of it.
A file that is not named was never written.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import DamagedError

FILE = "checksums"
PIECE_BYTES = 32_768
"""Of one checksum: large beside its own 4 bytes."""


MADE_FROM_IT = "coarse-"
"""Beginning of the names of folders that are made from the others, when they are needed; they have their own."""


class Checksums:
    """The files of a folder, as they were when their checksums were taken.

    `files`: by name within the folder: size [bytes], and the checksum of each piece.
    """

    def __init__(self, folder: Path, files: Mapping[str, tuple[int, NDArray[np.uint32]]]) -> None:
        self.folder, self._files = folder, files

    @classmethod
    def take(cls, folder: Path) -> Checksums:
        """Take the checksums of all files that are there now."""
        files = {}
        for file in sorted(_files(folder)):
            content = file.read_bytes()
            pieces = np.array(_pieces(content), np.uint32)
            files[file.relative_to(folder).as_posix()] = len(content), pieces
        return cls(folder, files)

    @classmethod
    def read(cls, folder: Path) -> Checksums | None:
        """Read what `write` wrote.

        Result: None where there are none. Raises DamagedError if they are damaged themselves.
        """
        try:
            own, _, content = (folder / FILE).read_bytes().partition(b"\n")
        except FileNotFoundError:
            return None
        if own != _own(content):
            raise damaged(f"{folder.name}/{FILE}", "its content is not what was written")
        files = json.loads(content)
        return cls(
            folder, {name: (size, np.frombuffer(bytes.fromhex(sums), ">u4")) for name, (size, sums) in files.items()}
        )

    def write(self) -> None:
        """Keep the checksums in their folder."""
        files = {name: [size, pieces.astype(">u4").tobytes().hex()] for name, (size, pieces) in self._files.items()}
        content = json.dumps(files, separators=(",", ":")).encode()
        begun = self.folder / f"{FILE}.{secrets.token_hex(4)}.partial"
        try:
            begun.write_bytes(_own(content) + b"\n" + content)
            begun.replace(self.folder / FILE)
        finally:
            begun.unlink(missing_ok=True)

    def __contains__(self, name: object) -> bool:
        return name in self._files

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def content(self, name: str) -> bytes:
        """Return a whole file. Raises DamagedError if it is missing, or damaged."""
        size, pieces = self._files[name]
        words = f"{self.folder.name}/{name}"
        try:
            found = (self.folder / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            raise damaged(words, "it is missing") from None
        if len(found) != size:
            raise damaged(words, f"it has {len(found)} bytes, and {size} were written")
        if not np.array_equal(_pieces(found), pieces):
            raise damaged(words, "its content is not what was written")
        return found

    def verify(self) -> None:
        """Read every file. Raises DamagedError if one is missing, or damaged."""
        for name in self:
            self.content(name)


def damaged(what: str, why: str) -> DamagedError:
    """Return the error of a part of a cost map, with what to do."""
    return DamagedError(
        f"the cost map is damaged: {what}: {why}. Make it again (`joulemap costmap`; for a service `joulemap check "
        "--repair`), or take it from a backup",
        file=what,
    )


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.is_file() and path.name != FILE and not path.name.endswith(".partial"):
            yield path
        elif path.is_dir() and not path.name.startswith((".", MADE_FROM_IT)):
            yield from _files(path)


def _pieces(content: bytes) -> list[int]:
    begins = range(0, max(len(content), 1), PIECE_BYTES)
    return [google_crc32c.value(content[begin : begin + PIECE_BYTES]) for begin in begins]


def _own(content: bytes) -> bytes:
    return b"%08x" % google_crc32c.value(content)
