"""Chunks of zarr arrays, decoded in the thread that asks, and the ones that were read last.

Through zarr a chunk goes to an event loop and to threads of its own, which takes several times as long as decoding it
and holds up all other threads of a search. Arrays that were written otherwise than joulemap writes them are read
through zarr.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs import blosc
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, BytesCodec, Endian
from zarr.storage import LocalStore

from joulemap.model.errors import InputError


def read_chunk(of: zarr.Array[Any], i: int, j: int) -> NDArray[Any]:
    """Read one chunk of an array.

    Parameters
    ----------
    of : zarr array, (rows, cols, ...)
        The array.
    i, j : int
        The chunk: its rows and columns begin at i and j times the sides of a chunk. It has all of the other axes.

    Returns
    -------
    ndarray
        Its values, without what lies beyond the array; not writable.

    Raises
    ------
    InputError
        If the chunk is damaged.
    """
    high, wide = of.chunks[:2]
    rows, cols = min(high, of.shape[0] - i * high), min(wide, of.shape[1] - j * wide)
    store = of.store_path.store
    if not isinstance(store, LocalStore) or not _is_own(of):
        return np.asarray(of[i * high : i * high + rows, j * wide : j * wide + cols])
    file = Path(store.root) / of.path / of.metadata.encode_chunk_key((i, j, *(0,) * (of.ndim - 2)))
    try:
        data = blosc.decompress(file.read_bytes())
        return np.frombuffer(data, dtype=of.dtype).reshape(of.chunks)[:rows, :cols]
    except FileNotFoundError:  # zarr writes no chunk that holds nothing but the fill value
        return np.full((rows, cols, *of.shape[2:]), of.fill_value, dtype=of.dtype)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{file} is a damaged chunk of a cost lattice: {error}", path=str(file)) from error


def read_array(of: zarr.Array[Any]) -> NDArray[Any]:
    """Read a whole array.

    Parameters
    ----------
    of : zarr array, (rows, cols, ...)
        The array.

    Returns
    -------
    ndarray, (rows, cols, ...)
        Its values.

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    out = np.empty(of.shape, dtype=of.dtype)
    high, wide = of.chunks[:2]
    for i in range(-(-of.shape[0] // high)):
        for j in range(-(-of.shape[1] // wide)):
            out[i * high : (i + 1) * high, j * wide : (j + 1) * wide] = read_chunk(of, i, j)
    return out


def _is_own(of: zarr.Array[Any]) -> bool:
    """Whether an array is cut along rows and columns alone, its values little-endian and compressed by Blosc only."""
    codecs: tuple[Any, ...] = getattr(of.metadata, "codecs", ())
    plain = [type(codec) for codec in codecs] == [BytesCodec, BloscCodec] and codecs[0].endian in (None, Endian.little)
    return plain and of.chunks[2:] == of.shape[2:]


class Chunks:
    """The chunks that were read last, of any arrays. Several threads may ask at once.

    Parameters
    ----------
    most_bytes : int
        Memory of what is kept [bytes].
    """

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._kept: OrderedDict[tuple[str, int, int], NDArray[Any]] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def get(self, of: zarr.Array[Any], i: int, j: int) -> NDArray[Any]:
        """Return one chunk, as `read_chunk`.

        Parameters
        ----------
        of : zarr array, (rows, cols, ...)
            The array.
        i, j : int
            The chunk.

        Returns
        -------
        ndarray
            Its values.
        """
        key = of.path, i, j
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        data = read_chunk(of, i, j)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = data
                self._size += data.nbytes
                while self._size > self._most and len(self._kept) > 1:
                    self._size -= self._kept.popitem(last=False)[1].nbytes
        return data
