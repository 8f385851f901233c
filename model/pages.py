"""Memory of large arrays that stay."""

from __future__ import annotations

import math
import mmap
import sys
from contextlib import suppress

import numpy as np
from numpy.typing import DTypeLike, NDArray

_LARGE_BYTES = 8_000_000


def empty_in_small_pages(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """Return an array without values, whose memory the system gives in its smallest pages.

    Parameters
    ----------
    shape : tuple of int
        Its shape.
    dtype : dtype_like
        Of its values.

    Returns
    -------
    ndarray
        Zeros where it is large and the system is Linux, else any values.

    Notes
    -----
    NumPy asks Linux for pages of 2 MB. A virtual machine may have to fetch such a page from its host: it takes 5 to
    16 ms, and 4.5 times as long as the same memory in small pages, and whatever waits for this processor or for the
    interpreter waits with it. For arrays that come and go, whose memory is used again, large pages are better.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if sys.platform != "linux" or size < _LARGE_BYTES:
        return np.empty(shape, dtype)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    with suppress(OSError):  # a kernel without large pages does not know the advice, and needs none
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype).reshape(shape)
