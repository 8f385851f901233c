"""Ending a search from another thread: the search looks at a flag again and again, which anybody may set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import NDArray

Flag = NDArray[np.uint8]

_NEVER: Flag = np.zeros(1, dtype=np.uint8)
_FLAG: ContextVar[Flag] = ContextVar("stop")


class Stopped(Exception):
    """The flag of a search was set: nobody waits for its answer any more."""


def new_flag() -> Flag:
    """Return a flag that is not set. Result (1,): write 1 into it to end what runs under it."""
    return np.zeros(1, dtype=np.uint8)


@contextmanager
def stoppable(flag: Flag) -> Iterator[None]:
    """Let searches that this thread begins inside end with `Stopped` soon after a flag is set.

    `flag` (1,): as of `new_flag`.
    """
    token = _FLAG.set(flag)
    try:
        yield
    finally:
        _FLAG.reset(token)


def stop_flag() -> Flag:
    """Return the flag of what this thread does.

    Result (1,): for kernels; one that is never set where nothing was said.
    """
    return _FLAG.get(_NEVER)


def check_stop() -> None:
    """Go on only while the flag of what this thread does is not set."""
    if stop_flag()[0]:
        raise Stopped
