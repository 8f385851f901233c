"""A worker: takes steps of cost maps one after another and does them, in the service or in a process of its own."""

from __future__ import annotations

import asyncio
import logging
import secrets
import threading
import time
from collections.abc import Callable

from sqlalchemy.exc import OperationalError

from model.errors import BusyError
from service.building import Builder
from service.problems import problem_of
from service.steps import LEASE_S, Step, Steps
from service.store import FAILED, QUEUED, RUNNING, Store

SERVICE = "service:"
"""How the names of workers inside a service begin; a data directory has one service, so they die with it."""

_LOG = logging.getLogger("joulemap.jobs")
_LOOK_S = 1.0  # between looks for a step that somebody else left or added
_WAIT_S = (0.01, 0.25)  # between looks whether a job is over: at first, and at most


class Worker:
    """Does steps with `builder` until stopped. A step that raises marks its cost map as failed.

    ready : called before a step; it may wait until kernels are warm, and raises BusyError where that takes too long.
    """

    def __init__(self, store: Store, builder: Builder, *, name: str, ready: Callable[[], object]) -> None:
        self._store = store
        self._builder = builder
        self._ready = ready
        self._name = name + secrets.token_hex(6)
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Work in a thread."""
        self._thread = threading.Thread(target=self.work, name="costmaps")
        self._thread.start()

    def wake(self) -> None:
        """There may be a step: look at once."""
        self._wake.set()

    def stop(self) -> None:
        """Return when the step at hand is done (a step is at most a tile); the others stay for the next start."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()

    def work(self) -> None:
        """Do steps in this thread until stopped."""
        steps = Steps(self._store.sessions, self._name)
        while not self._stopping.is_set():
            self._wake.clear()
            try:
                worked = self._do_next(steps)
            except OperationalError as error:  # a database that is busy or restarts comes back, and so does the step
                _LOG.warning("the database does not answer: %s", error.orig)
                worked = False
            if not worked:
                self._builder.rest()
                self._wake.wait(_LOOK_S)
        steps.release()

    def _do_next(self, steps: Steps) -> bool:
        """Take a step and do it; False when there is none."""
        step = steps.take()
        if step is None:
            return False
        with _Lease(steps, step):
            try:
                self._ready()
            except BusyError as error:  # no fault of the cost map: later
                _LOG.info("not ready: %s", error.message)
                steps.release()
                return False
            try:
                self._builder.do(step, steps)
            except OperationalError:
                raise
            except Exception as error:
                self._fail(step, error)
        return True

    def _fail(self, step: Step, error: Exception) -> None:
        if self._store.status(step.costmap_id) in (None, FAILED):  # deleted, or another worker's failure came first
            self._builder.discard(step.costmap_id)
            return
        problem = problem_of(error, step.costmap_id)
        if problem["status"] >= 500:
            _LOG.error("cost map %s failed", step.costmap_id, exc_info=error)
        self._store.fail_costmap(step.costmap_id, problem)
        self._builder.discard(step.costmap_id)


class _Lease:
    """Renews a step's lease while it is worked at."""

    def __init__(self, steps: Steps, step: Step) -> None:
        self._steps, self._step = steps, step
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._renew, name="lease", daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()

    def _renew(self) -> None:
        while not self._over.wait(LEASE_S / 3.0):
            try:
                if not self._steps.renew(self._step):
                    return
            except OperationalError as error:  # the next try may do; if none does, another worker takes the step
                _LOG.warning("a lease could not be renewed: %s", error.orig)


class CostmapJobs:
    """The jobs of one service: how many wait, when one is over, and the service's own worker."""

    def __init__(self, store: Store, worker: Worker | None, *, queue_size: int) -> None:
        self._store = store
        self._worker = worker
        self._queue_size = queue_size

    def resume(self) -> None:
        """Go on with what an earlier process left unfinished."""
        steps = Steps(self._store.sessions, SERVICE)
        steps.release(SERVICE)
        steps.add_missing()
        if self._worker is not None:
            self._worker.start()

    def check_room(self) -> None:
        """Raises BusyError when the queue is full."""
        waiting = len(self._store.unfinished())
        if waiting >= self._queue_size:
            raise BusyError(
                f"{waiting} cost maps wait already, the limit is {self._queue_size}: try again in a while",
                waiting=waiting, limit=self._queue_size, retry_after_s=10,
            )  # fmt: skip

    def submit(self) -> None:
        """A cost map was added."""
        if self._worker is not None:
            self._worker.wake()

    async def wait(self, costmap_id: str, timeout_s: float) -> None:
        """Return when the job is over, whoever does it, or after `timeout_s`."""
        pause, longest = _WAIT_S
        deadline = time.monotonic() + timeout_s
        while await asyncio.to_thread(self._store.status, costmap_id) in (QUEUED, RUNNING):
            left = deadline - time.monotonic()
            if left <= 0:
                return
            await asyncio.sleep(min(pause, left))
            pause = min(1.3 * pause, longest)

    def stop(self) -> None:
        if self._worker is not None:
            self._worker.stop()
