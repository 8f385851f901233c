"""How kernels are compiled: a decorator for those that make no arrays, and a word on standard error when they are.

That is at a first call, and takes up to a minute on a new machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

_PATIENCE_S = 2.0  # a kernel or two are not worth a word


def bare_njit(**how: Any) -> Callable[[Function], Function]:
    """Return numba's `njit` for a kernel that makes no arrays: it counts no references to those that it gets.

    `how`: as of `njit`. The counters are a third of the time of a short leg. `_nrt` is an option that numba does not
    document: without it kernels are slower, and their answers the same.
    """
    return njit(_nrt=False, **how)  # type: ignore[call-overload]


class _Notice(event.Listener):
    """Counts the seconds that numba compiles, and says so once."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._taken_s = 0.0
        self._said = False

    def silence(self) -> None:
        """Say nothing: somebody has said it."""
        self._said = True

    def on_start(self, event: event.Event) -> None:
        if self._said:
            return
        self._began = time.perf_counter()
        if self._taken_s >= _PATIENCE_S:
            self._said = True
            print(
                "joulemap: compiling kernels for this machine, which takes up to a minute and happens once "
                "(`joulemap warmup` does it ahead)",
                file=sys.stderr,
            )

    def on_end(self, event: event.Event) -> None:
        if self._began is not None and not self._said:
            self._taken_s += time.perf_counter() - self._began


NOTICE = _Notice()
"""That of this process."""


def say_when_compiling() -> None:
    """Say so in this process when kernels are compiled."""
    event.register("numba:compile", NOTICE)
