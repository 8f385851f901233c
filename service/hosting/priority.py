"""Who goes first on the processor: the event loop and short questions, then long ones and sent files, then jobs."""

from __future__ import annotations

import os
import sys
import threading

LONG_NICE, JOB_NICE = 5, 10
"""Of threads and processes for long questions and sent files, and for jobs; each 5 more get a third of the time."""


def be_nice(nice: int) -> None:
    """Let others go first on the processor: this thread alone on Linux, nothing elsewhere."""
    if nice and sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + nice)
