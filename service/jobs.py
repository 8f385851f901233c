"""The worker that makes cost maps in the background, one after another, and takes up again what a stop cut off."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial

from model.errors import BusyError
from service.problems import problem_of
from service.store import RUNNING, Store

Build = Callable[[str, Callable[[float], None]], None]
_LOG = logging.getLogger("joulemap.jobs")
_REPORT_S = 0.2


class JobStopped(Exception):
    """Raised inside a job when the service stops or its cost map was deleted; what it did is thrown away."""


class CostmapJobs:
    """Runs `build(costmap_id, progress)` in one thread.

    A job that raises marks its cost map as failed; one that is stopped leaves it unfinished, for the next start.
    """

    def __init__(self, store: Store, build: Build, *, queue_size: int) -> None:
        self._store = store
        self._build = build
        self._queue_size = queue_size
        self._lock = threading.RLock()  # a job that is over at once settles in the thread that entered it
        self._active: dict[str, Future[None]] = {}
        self._stopping = threading.Event()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="costmap")

    def resume(self) -> None:
        """Queue again what an earlier process left unfinished."""
        for costmap_id in self._store.unfinished():
            _LOG.info("cost map %s was not finished: queued again", costmap_id)
            self._enter(costmap_id)

    def check_room(self) -> None:
        """Raises BusyError when the queue is full."""
        with self._lock:
            waiting = len(self._active)
        if waiting >= self._queue_size:
            raise BusyError(
                f"{waiting} cost maps wait already, the limit is {self._queue_size}: try again in a while",
                waiting=waiting, limit=self._queue_size, retry_after_s=10,
            )  # fmt: skip

    def submit(self, costmap_id: str) -> None:
        self._enter(costmap_id)

    async def wait(self, costmap_id: str, timeout_s: float) -> None:
        """Return when the job is over, or after `timeout_s`."""
        with self._lock:
            future = self._active.get(costmap_id)
        if future is not None:
            await asyncio.wait([asyncio.wrap_future(future)], timeout=timeout_s)

    def forget(self, costmap_id: str) -> None:
        """Take a deleted cost map out of the queue; one that runs notices at its next progress."""
        with self._lock:
            future = self._active.get(costmap_id)
        if future is not None:
            future.cancel()

    def stop(self) -> None:
        """Stop soon; returns when the running job has let go."""
        self._stopping.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _enter(self, costmap_id: str) -> None:
        with self._lock:
            future = self._active[costmap_id] = self._pool.submit(self._run, costmap_id)
            future.add_done_callback(partial(self._settle, costmap_id))

    def _run(self, costmap_id: str) -> None:
        reported = 0.0

        def progress(share: float) -> None:
            nonlocal reported
            if self._stopping.is_set():
                raise JobStopped
            if time.monotonic() - reported > _REPORT_S:
                reported = time.monotonic()
                if not self._store.update_costmap(costmap_id, progress=min(max(share, 0.0), 1.0)):
                    raise JobStopped

        if self._store.update_costmap(costmap_id, status=RUNNING, progress=0.0):
            with suppress(JobStopped):
                self._build(costmap_id, progress)

    def _settle(self, costmap_id: str, future: Future[None]) -> None:
        """After a job: keep with the cost map whatever went wrong, then let waiters go."""
        error = None if future.cancelled() else future.exception()
        if error is not None:
            problem = problem_of(error, costmap_id)
            if problem["status"] >= 500:
                _LOG.error("cost map %s failed", costmap_id, exc_info=error)
            self._store.fail_costmap(costmap_id, problem)
        with self._lock:
            self._active.pop(costmap_id, None)
