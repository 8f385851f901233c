"""A word on standard error where kernels are compiled at a first call, which takes up to a minute on a new machine."""

from __future__ import annotations

import sys
import time

from numba.core import event

_PATIENCE_S = 2.0  # a kernel or two are not worth a word


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
