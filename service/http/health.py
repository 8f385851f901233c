"""Whether the service is ready: named checks that threads of their own repeat, so that no probe waits for one."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from joulemap.model.errors import JoulemapError
from joulemap.service.problems import without_places

Look = Callable[[], object]
"""Returns where all is well; raises a JoulemapError or an OSError, whose words say what is wrong, where it is not."""

OK, NOT_YET = "ok", "not looked at yet"
EVERY_S = 2.0
_AGAIN_S = 0.3  # after a look that found something wrong, as at the start
PATIENCE_S = 5.0
"""A check that has not returned for so long after its time has failed [s]; a rare one may take as long as its pause."""
_PROBE_BYTES = 65_536  # more than what file systems keep in a directory entry or an inode


class Health:
    """Named checks with their latest results. `clock`: returns a time that only grows [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._checks: dict[str, _Repeated] = {}
        self._over = threading.Event()

    def add(self, name: str, look: Look, *, every_s: float = EVERY_S) -> None:
        """Repeat a check until the service stops."""
        self._checks[name] = _Repeated(look, every_s, self._clock, self._over)

    def start(self) -> None:
        """Begin to look."""
        for name, check in self._checks.items():
            threading.Thread(target=check.repeat, name=f"check-{name}", daemon=True).start()

    def stop(self) -> None:
        """Look no more; a check that hangs is left to itself."""
        self._over.set()

    def results(self) -> dict[str, str]:
        """Return what the latest look at everything found, without looking again."""
        return {name: check.result() for name, check in self._checks.items()}


class _Repeated:
    """One check, and what it found last."""

    def __init__(self, look: Look, every_s: float, clock: Callable[[], float], over: threading.Event) -> None:
        self._look, self._every_s, self._clock, self._over = look, every_s, clock, over
        self._found = NOT_YET
        self._at = clock()

    def repeat(self) -> None:
        while True:
            self._found = self._once()
            self._at = self._clock()
            pause = self._every_s if self._found == OK else min(self._every_s, _AGAIN_S)
            if self._over.wait(pause):
                return

    def _once(self) -> str:
        try:
            self._look()
        except JoulemapError as error:
            return without_places(error.message)
        except OSError as error:
            return without_places(f"{error.strerror or error}")
        except Exception as error:  # a check that is broken has failed; its words are for the log and the probe
            return without_places(f"{type(error).__name__}: {error}"[:300])
        return OK

    def result(self) -> str:
        late_s = self._clock() - self._at - self._every_s
        return self._found if late_s < max(PATIENCE_S, self._every_s) else f"no answer for {late_s:.0f} s"


def disk_check(folder: Path, *, least_free_bytes: int, ok: Callable[[], object] = lambda: None) -> Look:
    """Return a check that files can be written."""

    def _look() -> None:
        free = shutil.disk_usage(folder).free
        if free < least_free_bytes:
            raise OSError(f"the disk is full: {free / 1e6:.0f} MB are free, at least {least_free_bytes / 1e6:.0f} MB")
        with tempfile.TemporaryFile(dir=folder, buffering=0) as probe:  # has no name: nothing is left of it
            probe.write(os.urandom(_PROBE_BYTES))
        ok()

    return _look
