"""Files for libraries that do not notice their end, or that they do not come further: what has no end is an error."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

_MOST_ENDS = 100
_LOOKS_PER_BYTE, _LOOKS = 5, 10_000
_BLOCK_BYTES = 1 << 20
_FILL = {0: "zeros", 255: "bytes of 255"}


def fill_at(file: Path) -> int:
    """Return where a file begins to hold nothing but zeros, or bytes of 255, up to its end.

    Room for a log may be taken before it is written, and stays so where the power is cut.

    Result: its length where its last byte is another one [bytes].
    """
    with file.open("rb") as stream:
        at = stream.seek(0, 2)
        last = b""
        while at > 0:
            begin = max(0, at - _BLOCK_BYTES)
            stream.seek(begin)
            block = stream.read(at - begin)
            last = last or block[-1:]
            if last[0] not in _FILL:
                return at
            kept = len(block.rstrip(last))
            if kept:
                return begin + kept
            at = begin
    return at


def filled(kind: str, file: Path, at: int) -> str:
    """Return the note of a log that ends in nothing but one byte again and again. `at`: where that begins [bytes]."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(-1, 2)
        fill = _FILL[stream.read(1)[0]]
    return (
        f"the {kind} was not closed: from byte {at:,} to its end at {size:,} it holds nothing but {fill}. What comes "
        "before is kept"
    )


class FiniteStream:
    """A binary stream that a library cannot read beyond its end for ever, as a corrupt count would have it.

    `end`: where it ends for the library [bytes], by default where it ends.
    """

    def __init__(self, stream: BinaryIO, *, end: int | None = None, most_steps: int | None = None) -> None:
        self._stream: Any = stream
        self._ended = self._steps = 0
        self._end, self._most_steps = end, most_steps

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        if size == 1:
            self._step()
        left = size
        if self._end is not None:
            left = max(0, self._end - self._stream.tell())
            left = left if size < 0 else min(size, left)
        data: bytes = self._stream.read(left)
        self._count(len(data) < size)
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place. Result: the place [bytes]."""
        if whence == 1 and offset < 0:
            self._step()
        place: int = self._stream.seek(offset, whence)
        return place

    def _step(self) -> None:
        self._steps += 1
        # an error that no library takes for one of its own, and skips
        if self._most_steps is not None and self._steps > self._most_steps:
            raise RuntimeError(f"more than {self._most_steps:,} bytes are no part of a record")

    def readinto(self, buffer: Any) -> int:
        """Read into memory."""
        count: int = self._stream.readinto(buffer)
        self._count(count < len(buffer))
        return count

    def _count(self, ended: bool) -> None:
        self._ended += ended
        if self._ended > _MOST_ENDS:
            raise EOFError("its end was reached again and again")


class FiniteMap:
    """Bytes that a library cannot look at for ever, as a message of length zero would have it.

    `at`: where it was looked at last [bytes].
    """

    def __init__(self, data: Any) -> None:
        self._data = data
        self._left = _LOOKS_PER_BYTE * len(data) + _LOOKS
        self.at = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._data, name)

    def __getitem__(self, part: Any) -> Any:
        self._left -= 1
        if self._left < 0:
            raise ValueError("a message has no length, so that reading comes no further")
        self.at = part.start if isinstance(part, slice) else part
        return self._data[part]
