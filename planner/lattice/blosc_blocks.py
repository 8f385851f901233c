"""A part of a Blosc file, decoded without the rest: Blosc compresses blocks of bytes on their own.

The header and the offsets of the blocks say where the wanted blocks lie. Only they are read, and given to the decoder
as a file that has no others.

Reference: the format of Blosc 1: README_CHUNK_FORMAT.rst of c-blosc.
"""

from __future__ import annotations

import struct

import numpy as np
from numcodecs import blosc

from joulemap.planner.lattice.checksums import OpenFile

_HEADER = struct.Struct("<4B3I")  # version, version of the codec, flags, bytes of a value; sizes: decoded, block, file
_COPIED = 0x2
"""Flag of a file that is not compressed and has no offsets."""
_FIRST_READ = 2048
"""Bytes that nearly always hold the header and all offsets."""


def decoded_part(file: OpenFile, first: int, end: int) -> tuple[int, bytes]:
    """Decode a part of a file that Blosc wrote.

    Returns `begin`: where the decoded part begins: at `first` or before; `data`: what was decoded, up to `end` at
    least. Raises DamagedError if what is read is not what was written.
    """
    size = file.size
    head = file.read(0, _FIRST_READ)
    if len(head) < _HEADER.size:
        raise ValueError(f"it has {len(head)} bytes, and a header {_HEADER.size}")
    version, codec, flags, item, decoded, block, written = _HEADER.unpack_from(head)
    if written != size or not block or not 0 <= first < end <= decoded:
        raise ValueError(f"its header says {written} bytes, of which the file has {size}, for {decoded} decoded ones")
    if first == 0 and end == decoded:
        return 0, blosc.decompress(file.read(0, size))
    if flags & _COPIED:
        return first, file.read(_HEADER.size + first, _HEADER.size + end)
    count = -(-decoded // block)
    after = _HEADER.size + 4 * count  # the offsets of the blocks stand before it
    if len(head) < after:
        head = file.read(0, after)
    starts = np.append(np.frombuffer(head, "<i4", count, _HEADER.size), size).astype(np.int64)
    a, b = first // block, -(-end // block)
    if starts[0] < after or (np.diff(starts) <= 0).any():  # threads that compress write blocks in any order
        return 0, blosc.decompress(file.read(0, size))
    if b * block > decoded and a > 0:  # the last block is shorter, and is decoded as such beside a whole one only
        a = min(a, b - 2)
    offsets = (starts[a:b] - starts[a] + _HEADER.size + 4 * (b - a)).astype("<i4").tobytes()
    blocks = file.read(int(starts[a]), int(starts[b]))
    whole = min(b * block, decoded) - a * block
    sizes = whole, block, _HEADER.size + len(offsets) + len(blocks)
    return a * block, blosc.decompress(_HEADER.pack(version, codec, flags, item, *sizes) + offsets + blocks)
