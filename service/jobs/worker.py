"""A worker: takes steps of jobs one after another and does them, in the service or in a process of its own."""

from __future__ import annotations

import asyncio
import logging
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from sqlalchemy.exc import OperationalError

from joulemap.model.errors import BusyError
from joulemap.service.jobs.steps import LEASE_S, Step, Steps
from joulemap.service.problems import problem_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import COSTMAP, FAILED, JOBS, QUEUED, RUNNING, WORDS, kind_of

SERVICE = "service:"
"""How the names of workers inside a service begin; a data directory has one service, so they die with it."""

_LOG = logging.getLogger("joulemap.jobs")
_LOOK_S = 1.0  # between looks for a step that somebody else left or added
_WAIT_S = (0.01, 0.25)  # between looks whether a job is over: at first, and at most


class Maker(Protocol):
    """Does the steps of jobs of one kind."""

    def do(self, step: Step, steps: Steps, report: Callable[[float], None]) -> None:
        """Do one step and say that it is done. report : is told now and then how far a long one is, 0..1; it raises
        Interrupted where nobody wants the step any more.
        """

    def rest(self) -> None:
        """Nothing is to be done."""

    def discard(self, job_id: str) -> None:
        """Throw away what was made of a job."""


class Interrupted(Exception):
    """The job at hand was deleted, or the worker is to stop."""


class Worker:
    """Does steps until stopped. A step that raises marks its job as failed.

    makers : by kind of job; ready : called before a step; it may wait until kernels are warm, and raises BusyError
    where that takes too long.
    """

    def __init__(self, store: Store, makers: Mapping[str, Maker], *, name: str, ready: Callable[[], object]) -> None:
        self._store = store
        self._makers = dict(makers)
        self._ready = ready
        self._name = name + secrets.token_hex(6)
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Work in a thread."""
        self._thread = threading.Thread(target=self.work, name="jobs")
        self._thread.start()

    def wake(self) -> None:
        """There may be a step: look at once."""
        self._wake.set()

    def stop(self) -> None:
        """Return when the step at hand is done, or a long one given up; what is left stays for the next start."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()

    def work(self) -> None:
        """Do steps in this thread until stopped."""
        steps = Steps(self._store.sessions, self._name, self._makers)
        while not self._stopping.is_set():
            self._wake.clear()
            try:
                worked = self._do_next(steps)
            except OperationalError as error:  # a database that is busy or restarts comes back, and so does the step
                _LOG.warning("the database does not answer: %s", error.orig)
                worked = False
            if not worked:
                for maker in self._makers.values():
                    maker.rest()
                self._wake.wait(_LOOK_S)
        steps.release()

    def _do_next(self, steps: Steps) -> bool:
        """Take a step and do it; False when there is none."""
        step = steps.take()
        if step is None:
            return False
        maker = self._makers[kind_of(step.job_id)]

        def report(progress: float) -> None:
            if self._stopping.is_set() or not steps.report(step, progress):
                raise Interrupted

        with _Lease(steps, step):
            try:
                self._ready()
            except BusyError as error:  # no fault of the job: later
                _LOG.info("not ready: %s", error.message)
                steps.release()
                return False
            try:
                maker.do(step, steps, report)
            except OperationalError:
                raise
            except Interrupted:
                if self._store.status(step.job_id) is None:
                    maker.discard(step.job_id)
            except Exception as error:
                self._fail(step, error)
        return True

    def _fail(self, step: Step, error: Exception) -> None:
        discard = self._makers[kind_of(step.job_id)].discard
        if self._store.status(step.job_id) in (None, FAILED):  # deleted, or another worker's failure came first
            discard(step.job_id)
            return
        problem = problem_of(error, step.job_id)
        if problem["status"] >= 500:
            _LOG.error("job %s failed", step.job_id, exc_info=error)
        self._store.fail(step.job_id, problem)
        discard(step.job_id)


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


class Jobs:
    """The jobs of one service: how many wait, when one is over, and the service's own workers."""

    def __init__(self, store: Store, workers: Sequence[Worker], *, queue_size: int) -> None:
        self._store = store
        self._workers = workers
        self._queue_size = queue_size

    def resume(self) -> None:
        """Go on with what an earlier process left unfinished."""
        steps = Steps(self._store.sessions, SERVICE, JOBS)
        steps.release(SERVICE)
        steps.add_missing()
        for worker in self._workers:
            worker.start()

    def check_room(self, kind: str = COSTMAP) -> None:
        """Raises BusyError when the queue of jobs of this kind is full."""
        waiting = len(self._store.unfinished(kind))
        if waiting >= self._queue_size:
            raise BusyError(
                f"{waiting} {WORDS[kind]}s wait already, the limit is {self._queue_size}: try again in a while",
                waiting=waiting,
                limit=self._queue_size,
                retry_after_s=10,
            )

    def submit(self) -> None:
        """A job was added."""
        for worker in self._workers:
            worker.wake()

    async def wait(self, job_id: str, timeout_s: float) -> None:
        """Return when the job is over, whoever does it, or after `timeout_s`."""
        pause, longest = _WAIT_S
        deadline = time.monotonic() + timeout_s
        while await asyncio.to_thread(self._store.status, job_id) in (QUEUED, RUNNING):
            left = deadline - time.monotonic()
            if left <= 0:
                return
            await asyncio.sleep(min(pause, left))
            pause = min(1.3 * pause, longest)

    def stop(self) -> None:
        for worker in self._workers:
            worker.stop()
