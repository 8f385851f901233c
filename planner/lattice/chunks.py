"""Chunks of zarr arrays that were read last, kept decoded: windows that are read one after another share them."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import damaged


def read(of: zarr.Array[Any], part: Any = ...) -> NDArray[Any]:
    """Read a part of an array. Raises DamagedError if a chunk is lost, or is not what was written."""
    try:
        return np.asarray(of[part])
    except (RuntimeError, ValueError) as error:  # as the decoder says it
        store = of.store_path.store
        folder = store.checksums.folder.name if isinstance(store, CheckedStore) else ""
        raise damaged(f"{folder}/{of.path}".strip("/"), str(error)) from error


class Chunks:
    """What was read last of the chunks of any arrays. Several threads may ask at once."""

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._kept: OrderedDict[tuple[str, int, int], NDArray[Any]] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def get(self, of: zarr.Array[Any], i: int, j: int) -> NDArray[Any]:
        """Return a chunk, without what lies beyond the array. `of` is (rows, cols, ...)."""
        key = of.path, i, j
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        high, wide = of.chunks[:2]
        chunk = read(of, np.s_[i * high : (i + 1) * high, j * wide : (j + 1) * wide])
        with self._lock:
            if key not in self._kept:  # another thread may have read it
                self._kept[key] = chunk
                self._size += chunk.nbytes
            while self._size > self._most and len(self._kept) > 1:
                self._size -= self._kept.popitem(last=False)[1].nbytes
        return chunk
