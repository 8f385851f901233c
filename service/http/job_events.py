"""How far jobs are, for all who wait: one look at the database serves every request that follows a job."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from typing import NamedTuple

import anyio
import anyio.to_thread
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import JOBS, QUEUED, RUNNING

_FIRST_S, _LONGEST_S = 0.01, 0.25  # between looks: at first, and at most
_LOG = logging.getLogger("joulemap.service")


class JobState(NamedTuple):
    """How far a job is.

    Attributes
    ----------
    status : str
        As of its row.
    progress : float
        Share that is done, 0..1.
    """

    status: str
    progress: float

    @property
    def over(self) -> bool:
        """Whether it changes no more."""
        return self.status not in (QUEUED, RUNNING)


UNKNOWN = JobState(QUEUED, 0.0)
"""Of a job at which nobody could look yet."""

Look = Callable[[Collection[str]], Mapping[str, JobState]]
"""Returns the states of the jobs of these ids, without those that were deleted."""


def look_into(store: Store) -> Look:
    """Return a look at the database of a store."""

    def _look(ids: Collection[str]) -> dict[str, JobState]:
        found: dict[str, JobState] = {}
        with store.sessions() as session:
            for kind, table in JOBS.items():
                wanted = [job_id for job_id in ids if job_id.startswith(f"{kind}-")]
                if wanted:
                    rows = session.execute(select(table.id, table.status, table.progress).where(table.id.in_(wanted)))
                    found |= {job_id: JobState(status, progress) for job_id, status, progress in rows}
        return found

    return _look


class JobEvents:
    """Looks at the jobs that somebody follows, as long as somebody does."""

    def __init__(self, look: Look) -> None:
        self._look = look
        self._followed: Counter[str] = Counter()
        self._states: Mapping[str, JobState] = {}
        self._looked = asyncio.Event()
        self._changed: dict[str, asyncio.Event] = {}
        """Of a job: set when its state is another one. So those who follow a job that does nothing cost nothing."""
        self._pause_s = _FIRST_S
        self._ended = False
        self._task: asyncio.Task[None] | None = None
        self._thread = anyio.CapacityLimiter(1)  # of its own: a look waits for no other request

    async def follow(self, job_id: str) -> AsyncIterator[JobState | None]:
        """Yield the state of a job now and whenever it has changed; None where it was deleted.

        It ends when the job is over, or when the service stops.
        """
        if job_id not in self._followed:
            self._pause_s = _FIRST_S
        self._followed[job_id] += 1
        try:
            seen: JobState | None = JobState("", -1.0)
            await self._next_look().wait()
            while not self._ended:
                changed = self._changed.setdefault(job_id, asyncio.Event())
                state = self._states.get(job_id)
                if state != seen:
                    seen = state
                    yield state
                if state is None or state.over:
                    return
                self._next_look()  # whose task may have ended
                await changed.wait()
        finally:
            self._followed[job_id] -= 1
            if not self._followed[job_id]:
                del self._followed[job_id]
                self._changed.pop(job_id, None)

    async def until_over(self, job_id: str, timeout_s: float) -> None:
        """Wait until a job is over or deleted, or the service stops."""
        with anyio.move_on_after(timeout_s):
            async for _state in self.follow(job_id):
                pass

    def end(self) -> None:
        """Let nobody wait any longer, because the service stops."""
        self._ended = True
        self._looked.set()
        for changed in self._changed.values():
            changed.set()

    def _next_look(self) -> asyncio.Event:
        """What the next look that begins from now on sets."""
        if self._task is None or self._task.done():
            self._looked = asyncio.Event()
            self._task = asyncio.create_task(self._watch())
        return self._looked

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(self._pause_s)
            if not self._followed:
                return
            self._pause_s = min(1.3 * self._pause_s, _LONGEST_S)
            looked, self._looked = self._looked, asyncio.Event()
            before = self._states
            try:
                self._states = await anyio.to_thread.run_sync(self._look, list(self._followed), limiter=self._thread)
            except SQLAlchemyError as error:  # it comes back: who waits sees the states of before, and waits again
                _LOG.warning("the database does not answer: %s", getattr(error, "orig", error))
                self._states = {**dict.fromkeys(self._followed, UNKNOWN), **self._states}
            finally:
                looked.set()
                for job_id in list(self._changed):
                    if before.get(job_id) != self._states.get(job_id):
                        self._changed.pop(job_id).set()
