"""A worker takes steps of jobs one after another and does them, in the service or in its own process."""

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
"""Beginning of the names of workers inside a service; a data directory has one service, so they end with it."""

_LOG = logging.getLogger("joulemap.jobs")
_LOOK_S = 1.0  # between looks for a step that somebody else left or added
_WAIT_S = (0.01, 0.25)  # between looks whether a job is over: at first, and at most


class Maker(Protocol):
    """Does the steps of jobs of one kind."""

    def do(self, step: Step, steps: Steps, report: Callable[[float], None]) -> None:
        """Do one step and mark it as done.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.
        steps : Steps
            Where it is marked as done.
        report : callable
            To be called again and again in a long step with the share that is done, 0..1; raises Interrupted where
            the job is to stop.
        """

    def rest(self) -> None:
        """Let go of what is kept between steps, because there is nothing to do."""

    def discard(self, job_id: str) -> None:
        """Delete what was made of a job.

        Parameters
        ----------
        job_id : str
            Its id.
        """


class Interrupted(Exception):
    """The job at hand was deleted, or the worker is to stop."""


class Worker:
    """Does steps until it is stopped; a step that raises marks its job as failed.

    Parameters
    ----------
    store : Store
        Open.
    makers : mapping of str to Maker
        By kind of job.
    name : str
        Beginning of the worker's name; a random part is added.
    ready : callable
        Called before each step. It may wait until the kernels are loaded, and raises BusyError if that takes too long.
    """

    def __init__(self, store: Store, makers: Mapping[str, Maker], *, name: str, ready: Callable[[], object]) -> None:
        self._store = store
        self._makers = dict(makers)
        self._ready = ready
        self._name = name + secrets.token_hex(6)
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to work, in a thread."""
        self._thread = threading.Thread(target=self.work, name="jobs")
        self._thread.start()

    def wake(self) -> None:
        """Look for a step now, not at the next regular time."""
        self._wake.set()

    def stop(self) -> None:
        """Stop after the current step, or within a long one; the rest of the job waits for the next start."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()

    def work(self) -> None:
        """Work in this thread until `stop` is called."""
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
            except BusyError as error:  # not the job's fault: later
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
    """Renews the lease of a step while it is done."""

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
            except OperationalError as error:  # the next try may succeed; if none does, another worker takes the step
                _LOG.warning("a lease could not be renewed: %s", error.orig)


class Jobs:
    """The jobs of one service: how many wait, when one has ended, and the workers of the service itself.

    Parameters
    ----------
    store : Store
        Open once `resume` is called.
    workers : sequence of Worker
        Those in this process.
    queue_size : int
        Most jobs of a kind that wait or run.
    """

    def __init__(self, store: Store, workers: Sequence[Worker], *, queue_size: int) -> None:
        self._store = store
        self._workers = workers
        self._queue_size = queue_size

    def resume(self) -> None:
        """Start the workers, and go on with what an earlier process left unfinished."""
        steps = Steps(self._store.sessions, SERVICE, JOBS)
        steps.release(SERVICE)
        steps.add_missing()
        for worker in self._workers:
            worker.start()

    def check_room(self, kind: str = COSTMAP) -> None:
        """Check that one more job may be added.

        Parameters
        ----------
        kind : str, optional
            COSTMAP or CALIBRATION.

        Raises
        ------
        BusyError
            If the queue of this kind is full.
        """
        waiting = len(self._store.unfinished(kind))
        if waiting >= self._queue_size:
            raise BusyError(
                f"the queue is full: {WORDS[kind]}s that wait or run: {waiting}, limit: {self._queue_size}",
                waiting=waiting,
                limit=self._queue_size,
                retry_after_s=10,
            )

    def submit(self) -> None:
        """Wake the workers, because a job was added."""
        for worker in self._workers:
            worker.wake()

    async def wait(self, job_id: str, timeout_s: float) -> None:
        """Wait until a job has ended, whichever worker does it.

        Parameters
        ----------
        job_id : str
            Its id.
        timeout_s : float
            Longest time to wait [s].
        """
        pause, longest = _WAIT_S
        deadline = time.monotonic() + timeout_s
        while await asyncio.to_thread(self._store.status, job_id) in (QUEUED, RUNNING):
            left = deadline - time.monotonic()
            if left <= 0:
                return
            await asyncio.sleep(min(pause, left))
            pause = min(1.3 * pause, longest)

    def stop(self) -> None:
        """Stop the workers of this process."""
        for worker in self._workers:
            worker.stop()
