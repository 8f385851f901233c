"""What is asked of the operating system: who goes first on the processor, and freed memory that is given back."""

from __future__ import annotations

import ctypes
import os
import sys
import threading

LONG_NICE, JOB_NICE = 5, 10
"""Of threads and processes for long questions and sent files, and for jobs; each 5 more get a third of the time."""


def be_nice(nice: int) -> None:
    """Let others go first on the processor: this thread alone on Linux, nothing elsewhere."""
    if nice and sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + nice)


def give_back_freed_memory() -> bool:
    """Have what lies free in the heaps of this process given back to the system.

    Only glibc has such a call; other libraries give memory back by themselves.

    glibc takes arrays below 32 MB from its heaps, where they lie between smaller blocks that stay. What is freed there
    is used again, but not given back: with cost maps that come and go the memory grows for hours. A mapping of its own
    for each array costs a question a tenth of its time, because every page of it is fetched anew.
    """
    if not sys.platform.startswith("linux"):
        return False
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return trim is not None and bool(trim(0))
