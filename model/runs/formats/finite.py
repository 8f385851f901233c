"""Files for libraries that do not notice their end, or that they do not come further: what has no end is an error."""

from __future__ import annotations

from typing import Any, BinaryIO

_MOST_ENDS = 100
_LOOKS_PER_BYTE, _LOOKS = 5, 10_000


class FiniteStream:
    """A binary stream that a library cannot read beyond its end for ever, as a corrupt count would have it.

    Parameters
    ----------
    stream : BinaryIO
        The file.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream: Any = stream
        self._ended = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes.

        Parameters
        ----------
        size : int, optional
            How many; all without it.

        Returns
        -------
        bytes
            Fewer at the end of the file.

        Raises
        ------
        EOFError
            If the end was reached too often.
        """
        data: bytes = self._stream.read(size)
        self._count(len(data) < size)
        return data

    def readinto(self, buffer: Any) -> int:
        """Read into memory.

        Parameters
        ----------
        buffer : buffer
            Where to.

        Returns
        -------
        int
            How many bytes were read.

        Raises
        ------
        EOFError
            If the end was reached too often.
        """
        count: int = self._stream.readinto(buffer)
        self._count(count < len(buffer))
        return count

    def _count(self, ended: bool) -> None:
        self._ended += ended
        if self._ended > _MOST_ENDS:
            raise EOFError("its end was reached again and again")


class FiniteMap:
    """Bytes that a library cannot look at for ever, as a message of length zero would have it.

    Parameters
    ----------
    data : mmap
        The file.

    Attributes
    ----------
    at : int
        Where it was looked at last [bytes].
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
