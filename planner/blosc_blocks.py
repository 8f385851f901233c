"""A part of a Blosc file, decoded without the rest: Blosc compresses blocks of bytes on their own.

The header and the offsets of the blocks say where the wanted blocks lie. Only they are read, and given to the decoder
as a file that has no others.

References
----------
The format of Blosc 1: README_CHUNK_FORMAT.rst of c-blosc.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
from numcodecs import blosc

_HEADER = struct.Struct("<4B3I")  # version, version of the codec, flags, bytes of a value; sizes: decoded, block, file
_COPIED = 0x2
"""Flag of a file that is not compressed and has no offsets."""
_FIRST_READ = 2048
"""Bytes that nearly always hold the header and all offsets."""


def decoded_part(file: Path, first: int, end: int) -> tuple[int, bytes]:
    """Decode a part of a file that Blosc wrote.

    Parameters
    ----------
    file : Path
        The file.
    first, end : int
        The bytes that are wanted, counted as decoded.

    Returns
    -------
    begin : int
        Where the decoded part begins: at `first` or before.
    data : bytes
        What was decoded, up to `end` at least.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is damaged.
    RuntimeError
        If the decoder says so.
    """
    source = os.open(file, os.O_RDONLY)
    try:
        size = os.fstat(source).st_size
        head = os.pread(source, _FIRST_READ, 0)
        if len(head) < _HEADER.size:
            raise ValueError(f"it has {len(head)} bytes, and a header {_HEADER.size}")
        version, codec, flags, item, decoded, block, written = _HEADER.unpack_from(head)
        if written != size or not block or not 0 <= first < end <= decoded:
            raise ValueError(
                f"its header says {written} bytes, of which the file has {size}, for {decoded} decoded ones"
            )
        if first == 0 and end == decoded:
            return 0, blosc.decompress(os.pread(source, size, 0))
        if flags & _COPIED:
            return first, os.pread(source, end - first, _HEADER.size + first)
        count = -(-decoded // block)
        after = _HEADER.size + 4 * count  # the offsets of the blocks stand before it
        if len(head) < after:
            head = os.pread(source, after, 0)
        starts = np.append(np.frombuffer(head, "<i4", count, _HEADER.size), size).astype(np.int64)
        a, b = first // block, -(-end // block)
        if starts[0] < after or (np.diff(starts) <= 0).any():  # threads that compress write blocks in any order
            return 0, blosc.decompress(os.pread(source, size, 0))
        if b * block > decoded and a > 0:  # the last block is shorter, and is decoded as such beside a whole one only
            a = min(a, b - 2)
        offsets = (starts[a:b] - starts[a] + _HEADER.size + 4 * (b - a)).astype("<i4").tobytes()
        blocks = os.pread(source, int(starts[b] - starts[a]), int(starts[a]))
        whole = min(b * block, decoded) - a * block
        sizes = whole, block, _HEADER.size + len(offsets) + len(blocks)
        return a * block, blosc.decompress(_HEADER.pack(version, codec, flags, item, *sizes) + offsets + blocks)
    finally:
        os.close(source)
