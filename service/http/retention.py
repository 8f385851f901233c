"""Notes what is used, and removes now and then what was not used for a long time or has no room."""

from __future__ import annotations

import asyncio
import datetime as dt
import logging
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

import anyio
from sqlalchemy.exc import SQLAlchemyError

from joulemap.service.hosting.settings import Settings
from joulemap.service.storage.retention import forget_ages, measure, note_uses, remove_unused
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import HeightmapRow, RunsRow

NOTE_S, SWEEP_S = 60.0, 600.0
"""Between notes of what was used, and between sweeps [s]."""

_JUMP_S = 300.0  # more than a clock that is kept in time is corrected by between two sweeps
_LOG = logging.getLogger("joulemap.service")

Clock = Callable[[], float]
"""Returns a time [s]."""


def _since_boot() -> float:
    """A time that nobody sets, and that goes on while the machine sleeps [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class Retention:
    """What a service does about what it keeps."""

    def __init__(
        self,
        settings: Settings,
        store: Store,
        delete: Mapping[Any, Callable[[str], object]],
        *,
        clocks: tuple[Clock, Clock] = (time.time, _since_boot),
    ) -> None:
        self._settings, self._store = settings, store
        delete = {**delete, RunsRow: store.delete_runs, HeightmapRow: store.delete_heightmap}
        self._delete = {table: self._while_running(one) for table, one in delete.items()}
        self._uses: dict[str, dt.datetime] = {}
        self._lock, self._ended = threading.Lock(), False
        self._clocks = clocks
        self._offset_s, self._steady_since_s = self._ahead_s(), self._clocks[1]()
        self._thread = anyio.CapacityLimiter(1)

    def saw(self, job_id: str) -> None:
        """Note that a cost map or a calibration is used now."""
        with self._lock:
            self._uses[job_id] = self._now()

    def note(self) -> None:
        """Write down what was used."""
        with self._lock:
            uses, self._uses = self._uses, {}
        if uses:
            note_uses(self._store, uses)

    def sweep(self) -> list[str]:
        """Remove what was not used for a long time or has no room."""
        self.note()
        gb, days = self._settings.retention_gb, self._settings.retention_days
        if days is not None and not self._clock_is_steady():
            days = None
        return remove_unused(
            self._store,
            self._delete,
            now=self._now(),
            days=days,
            most_bytes=None if gb is None else int(gb * 1e9),
        )

    def _ahead_s(self) -> float:
        """The time of day before a clock that nobody sets [s]."""
        return self._clocks[0]() - self._clocks[1]()

    def _clock_is_steady(self) -> bool:
        """Whether the time of day can be believed: a machine may start with a wrong one, which is set later.

        Where it was set, the times of all uses are unknown, and ages count from then.
        """
        jumped_s = self._ahead_s() - self._offset_s
        if abs(jumped_s) > _JUMP_S:
            _LOG.warning(
                "the clock of this machine was set by %+.0f s: the age of what is kept counts from now", jumped_s
            )
            forget_ages(self._store, self._now())
            self._offset_s, self._steady_since_s = self._ahead_s(), self._clocks[1]()
        return self._clocks[1]() - self._steady_since_s >= SWEEP_S

    def _now(self) -> dt.datetime:
        return dt.datetime.fromtimestamp(self._clocks[0](), dt.UTC).replace(tzinfo=None)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Do this now and then, on a thread of its own."""
        task = asyncio.create_task(self._run())
        try:
            yield
        finally:
            self._ended = True
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            await self._do(self.note)

    def _while_running(self, delete: Callable[[str], object]) -> Callable[[str], None]:
        def _delete(row_id: str) -> None:
            if self._ended:
                raise InterruptedError("the service stops")
            delete(row_id)

        return _delete

    async def _run(self) -> None:
        limited = self._settings.retention_days is not None or self._settings.retention_gb is not None
        await self._do(lambda: measure(self._store))
        swept = -float("inf")
        clock = asyncio.get_running_loop().time
        while True:
            if limited and clock() - swept >= SWEEP_S:
                swept = clock()
                await self._do(self.sweep)
            else:
                await self._do(self.note)
            await asyncio.sleep(NOTE_S)

    async def _do(self, work: Callable[[], object]) -> None:
        try:
            await anyio.to_thread.run_sync(work, limiter=self._thread)
        except (SQLAlchemyError, OSError, ValueError) as error:  # a database that is away, a row that nobody can read
            _LOG.warning("what was not used cannot be removed now: %s", error)
