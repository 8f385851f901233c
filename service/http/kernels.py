"""The compiled kernels of a service: loaded on a thread when it starts, awaited by requests that compute."""

from __future__ import annotations

import gc
import logging
import threading
from collections.abc import Callable
from functools import cache

import anyio

from joulemap.model.errors import BusyError, JoulemapError
from joulemap.planner.grid.stopping import Stopped, new_flag, stoppable
from joulemap.service.work.warm_up import warm_up

_LOG = logging.getLogger("joulemap.service")
_WAIT_S, _LOOK_S, _STOP_S = 120.0, 0.05, 3.0
_COLLECTED_AFTER = 2_000, 10, 100
"""When cycles are looked for: after so many new objects among them, every tenth time among those that were left since,
and every hundredth time of these among all. No other thread runs meanwhile: among 50,000 objects it takes 50 ms on a
busy machine. Python's own numbers (700, 10, 10) double the time to read a long path."""


class Kernels:
    """The kernels of a service. `seconds`: how long loading took [s], None until then."""

    def __init__(self) -> None:
        self.seconds: float | None = None
        self._failure = "see the log"
        self._ended, self._stop = threading.Event(), new_flag()

    def load(self, check: Callable[[], object]) -> None:
        """Load them on a thread."""
        threading.Thread(target=self._load, args=(check,), name="warm-up", daemon=True).start()

    def stop(self) -> None:
        """End loading, before the folder goes in which it has a map; only a kernel that is being compiled goes on."""
        self._stop[0] = 1
        self._ended.wait(_STOP_S)

    async def loaded(self) -> None:
        """Wait until they are loaded, without a thread."""
        if not self._ended.is_set():
            with anyio.move_on_after(_WAIT_S):
                while not self._ended.is_set():
                    await anyio.sleep(_LOOK_S)
            self.wait(0.0)

    def wait(self, seconds: float = _WAIT_S) -> None:
        """Wait until they are loaded."""
        if not self._ended.wait(seconds):
            raise BusyError("the service is still compiling its kernels", retry_after_s=10)

    def check(self) -> float:
        """Return how long loading took."""
        if self.seconds is not None:
            return self.seconds
        if self._ended.is_set():
            raise BusyError(f"not ready: loading failed: {self._failure}", failed=True)
        raise BusyError("not ready: kernels are being compiled or loaded", failed=False, retry_after_s=2)

    def _load(self, check: Callable[[], object]) -> None:
        try:
            with stoppable(self._stop):
                check()
                self.seconds = _loaded()
            _LOG.info("kernels are loaded after %.1f s", self.seconds)
        except Stopped:
            self._failure = "the service stops"
        except JoulemapError as error:
            self._failure = error.message
            _LOG.error("loading the kernels failed: %s", error.message)
        finally:
            self._ended.set()


@cache
def _loaded() -> float:
    """Load the kernels, once for all services of a process; the time that it took [s]."""
    seconds = warm_up(models=())
    gc.collect()
    gc.freeze()  # a million objects of libraries that stay: to go over them again stalls everything for 0.5 s
    gc.set_threshold(*_COLLECTED_AFTER)
    return seconds
