"""How the C library keeps memory: large blocks are given back as soon as they are freed."""

from __future__ import annotations

import ctypes
import sys

BLOCK_BYTES = 1 << 20
"""From this size on a block has a mapping of its own, which ends with it."""
_M_MMAP_THRESHOLD = -3  # of malloc.h


def give_back_large_blocks() -> bool:
    """Have large blocks of this process given back to the system when they are freed.

    Returns
    -------
    bool
        Whether the C library can be told so; others than glibc do it anyway, or not at all.

    Notes
    -----
    Without this glibc raises the size up to 32 MB with the blocks that are freed. The arrays of cost maps then lie in
    its heaps, between smaller blocks that stay, and what is free there is lost to the system: with cost maps that come
    and go the memory grows for hours.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(mallopt(_M_MMAP_THRESHOLD, BLOCK_BYTES))
