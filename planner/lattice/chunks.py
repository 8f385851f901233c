"""Chunks of zarr arrays, decoded in the thread that asks, and the ones that were read last.

Through zarr a chunk goes to an event loop and to threads of its own, which takes several times as long as decoding it
and holds up all other threads of a search. Of a chunk only the wanted rows are decoded, and its borders are kept for
longer than the rest, since windows reach a little beyond a chunk. Arrays that were written otherwise than joulemap
writes them are read through zarr.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, BytesCodec, Endian

from joulemap.model.threads import share_out
from joulemap.planner.lattice.blosc_blocks import decoded_part
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import damaged

BORDER_CELLS = 3
"""Rows and columns of a border: as far as the longest grid move reaches."""
_KEPT_ROWS = 4
"""Fewer rows than a chunk has over this are decoded again rather than kept."""


def read_chunk(of: zarr.Array[Any], i: int, j: int, top: int = 0, down: int | None = None) -> NDArray[Any]:
    """Read rows of one chunk of an array.

    `of` is (rows, cols, ...). Result: its values, without what lies beyond the array; not writable. Raises DamagedError
    if the chunk is lost, or is not what was written.
    """
    high, wide = of.chunks[:2]
    rows, cols = min(high, of.shape[0] - i * high), min(wide, of.shape[1] - j * wide)
    down = rows if down is None else down
    store = of.store_path.store
    if not isinstance(store, CheckedStore) or not _is_own(of):
        return np.asarray(of[i * high + top : i * high + down, j * wide : j * wide + cols])
    sums = store.checksums
    file = f"{of.path}/{of.metadata.encode_chunk_key((i, j, *(0,) * (of.ndim - 2)))}".removeprefix("/")
    if file not in sums:  # zarr writes no chunk that holds nothing but the fill value
        return np.full((down - top, cols, *of.shape[2:]), of.fill_value, dtype=of.dtype)
    row_bytes = math.prod(of.chunks[1:]) * of.dtype.itemsize
    try:
        with sums.open(file) as content:
            begin, data = decoded_part(content, top * row_bytes, down * row_bytes)
        values = np.frombuffer(data, of.dtype, (down - top) * row_bytes // of.dtype.itemsize, top * row_bytes - begin)
        return values.reshape(down - top, *of.chunks[1:])[:, :cols]
    except (RuntimeError, ValueError) as error:
        raise damaged(f"{sums.folder.name}/{file}", str(error)) from error


def read_array(of: zarr.Array[Any]) -> NDArray[Any]:
    """Read a whole array, its chunks on several threads.

    `of` is (rows, cols, ...). The result is (rows, cols, ...). Raises DamagedError if a chunk is lost, or is not what
    was written.
    """
    out = np.empty(of.shape, of.dtype)
    high, wide = of.chunks[:2]

    def _read(chunk: tuple[int, int]) -> None:
        i, j = chunk
        out[i * high : (i + 1) * high, j * wide : (j + 1) * wide] = read_chunk(of, i, j)

    share_out(_read, [(i, j) for i in range(-(-of.shape[0] // high)) for j in range(-(-of.shape[1] // wide))])
    return out


def _is_own(of: zarr.Array[Any]) -> bool:
    """Whether an array is cut along rows and columns alone, its values little-endian and compressed by Blosc only."""
    codecs: tuple[Any, ...] = getattr(of.metadata, "codecs", ())
    plain = [type(codec) for codec in codecs] == [BytesCodec, BloscCodec] and codecs[0].endian in (None, Endian.little)
    return plain and of.chunks[2:] == of.shape[2:]


class Chunks:
    """What was read last of the chunks of any arrays. Several threads may ask at once."""

    def __init__(self, most_bytes: int) -> None:
        self._rows = _Kept(most_bytes // 3)
        self._borders = _Kept(most_bytes - most_bytes // 3)

    def get(self, of: zarr.Array[Any], i: int, j: int, rows: tuple[int, int], cols: tuple[int, int]) -> NDArray[Any]:
        """Return a part of one chunk. `of` is (rows, cols, ...)."""
        (top, down), (left, right) = rows, cols
        sides = _sides(of, i, j)
        for side, (row, row1, col, col1) in sides.items():
            if row <= top and down <= row1 and col <= left and right <= col1:
                kept = self._borders.get((of.path, i, j, side))
                if kept is not None and kept[1][top - row : down - row].all():
                    return kept[0][top - row : down - row, left - col : right - col]
        kept = self._rows.get((of.path, i, j, top))
        if kept is not None and len(kept[0]) >= down - top:
            return kept[0][: down - top, left:right]
        data = read_chunk(of, i, j, top, down)
        if len(data) * _KEPT_ROWS >= of.chunks[0]:
            self._rows.put((of.path, i, j, top), (data,))
            for side, (row, row1, col, col1) in sides.items():
                key = of.path, i, j, side
                values, known = self._borders.get(key) or (
                    np.empty((row1 - row, col1 - col, *of.shape[2:]), dtype=of.dtype),
                    np.zeros(row1 - row, dtype=np.bool_),
                )
                first, end = max(row, top), max(min(row1, down), max(row, top))
                values[first - row : end - row] = data[first - top : end - top, col:col1]
                known[first - row : end - row] = True  # after the values: another thread may be looking
                self._borders.put(key, (values, known))
        return data[:, left:right]


def _sides(of: zarr.Array[Any], i: int, j: int) -> dict[str, tuple[int, int, int, int]]:
    """The four borders of a chunk: first row, the one after the last, and the same for columns."""
    rows = min(of.chunks[0], of.shape[0] - i * of.chunks[0])
    cols = min(of.chunks[1], of.shape[1] - j * of.chunks[1])
    return {
        "north": (0, min(BORDER_CELLS, rows), 0, cols),
        "south": (max(rows - BORDER_CELLS, 0), rows, 0, cols),
        "west": (0, rows, 0, min(BORDER_CELLS, cols)),
        "east": (0, rows, max(cols - BORDER_CELLS, 0), cols),
    }


class _Kept:
    """Arrays of a limited size together, those that were asked for last."""

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._kept: OrderedDict[tuple[Any, ...], tuple[NDArray[Any], ...]] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def get(self, key: tuple[Any, ...]) -> tuple[NDArray[Any], ...] | None:
        """What is kept by that name."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def put(self, key: tuple[Any, ...], arrays: tuple[NDArray[Any], ...]) -> None:
        """Keep arrays, and let go of those that were not asked for the longest."""
        with self._lock:
            self._size += _size(arrays) - _size(self._kept.pop(key, ()))
            self._kept[key] = arrays
            while self._size > self._most and len(self._kept) > 1:
                self._size -= _size(self._kept.popitem(last=False)[1])


def _size(arrays: tuple[NDArray[Any], ...]) -> int:
    return sum(array.nbytes for array in arrays)
