"""The jobs of a service: what the database wants and nobody makes is sent to a Dask cluster, and its end is noted.

Nothing is asked of the cluster but to do what it is sent. The database says which jobs are wanted, and the store which
parts are there. A service that starts, or that gets its cluster or its database back, sends off what is missing.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from sqlalchemy.exc import OperationalError

from joulemap.model.errors import InputError
from joulemap.service.cluster.connection import Attendance
from joulemap.service.hosting.settings import Settings
from joulemap.service.hosting.system import JOB_NICE
from joulemap.service.jobs import calibrations, costmaps
from joulemap.service.problems import problem_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CALIBRATION, kind_of
from joulemap.service.work.calibrations import Refused

if TYPE_CHECKING:
    from distributed import Client


def turns_of(wanted: Mapping[str, str | None], before: Mapping[str, int]) -> dict[str, int]:
    """Return the turn of each job, lower ones first: an owner's jobs one after another, beside those of others.

    `wanted`: owner by the id of a job, oldest first; `before`: the turns of the latest call. A job keeps its turn.
    """
    turns = {job_id: turn for job_id, turn in before.items() if job_id in wanted}
    for job_id, owner in wanted.items():
        if job_id not in turns:
            now = min(turns.values(), default=0)
            latest = max((turn for other, turn in turns.items() if wanted[other] == owner), default=now - 1)
            turns[job_id] = max(now, latest + 1)
    return turns


_LOG = logging.getLogger("joulemap.jobs")
_LOOK_S = 2.0  # between looks for what another service added, deleted or left behind
_REPORT_S = 0.5  # between reports of the progress of a job
_STOP_S = 6.0  # until the cluster has stopped; its processes end with this one in any case
_TRIES = 3  # of a job that ends with an error of ours
_LATER = (errno.ENOSPC, errno.EDQUOT, errno.EHOSTUNREACH)  # a full disk, an object store that does not answer


class Jobs:
    """The jobs of one service, and the cluster that makes them."""

    def __init__(self, store: Store, settings: Settings, *, on_made: Callable[[str], object] | None = None) -> None:
        self._store, self._settings, self._on_made = store, settings, on_made
        self._at_work = settings.scheduler is not None or settings.workers > 0
        self._failures: dict[str, int] = {}
        self._wake, self._stopping = asyncio.Event(), False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self.trouble: str | None = "the workers are starting" if self._at_work else None

    def start(self) -> None:
        """Start the cluster, or connect to it, on a thread; go on with what an earlier process left unfinished."""
        if self._at_work:
            self._thread = threading.Thread(target=lambda: asyncio.run(self._live()), name="jobs", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop the cluster of this process; what is not finished waits for the next start, or for another service."""
        if self._thread is not None:
            self._stopping = True
            self.submit()
            self._thread.join(_STOP_S)

    def submit(self) -> None:
        """Look for a new job now, not at the next regular time."""
        if self._loop is None:
            self._wake.set()
        else:
            with suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self._wake.set)

    async def _live(self) -> None:
        """Keep a cluster until the service stops; one that is lost is asked again."""
        from joulemap.service.cluster.connection import connected  # which takes half a second to load
        from joulemap.service.work.warm import Warm

        self._loop, settings = asyncio.get_running_loop(), self._settings
        while not self._stopping:
            try:
                async with connected(settings.scheduler, workers=settings.workers) as client:
                    nice = 0 if settings.scheduler else JOB_NICE
                    warm = Warm(settings.warm_models, settings.resolved_models_dir.resolve(), nice=nice)
                    await client.register_plugin(warm)
                    await self._serve(client)
            except OSError as error:  # a scheduler that restarts comes back
                words = str(error) or "nothing within its time"
                self.trouble = f"no Dask scheduler answers at {settings.scheduler or '127.0.0.1'}: {words}"
                _LOG.warning("%s", self.trouble)
            except InputError as error:
                self.trouble = error.message
                _LOG.error("%s", self.trouble)
            except Exception:
                self.trouble = "the workers do not start: see the log"
                _LOG.exception("%s", self.trouble)
            await self._pause()

    async def _watch(self, client: Client) -> None:
        """Look for workers again and again, also while the database does not answer."""
        attendance = Attendance(client, self._settings.scheduler)
        while True:
            self.trouble = await attendance.trouble()
            await asyncio.sleep(_LOOK_S)

    async def _serve(self, client: Client) -> None:
        """Send off what is wanted until the service stops. Raises OSError where the scheduler is lost."""
        watching = asyncio.create_task(self._watch(client))
        making: dict[str, asyncio.Task[None]] = {}
        claims = self._store.claims()
        turns: dict[str, int] = {}
        try:
            while not self._stopping:
                if client.status != "running":
                    raise ConnectionError("the connection is lost")
                if watching.done():
                    watching.result()  # it ends with an error only, which is said as that of any other step
                try:
                    wanted = await asyncio.to_thread(self._store.wanted)
                    ours = await asyncio.to_thread(claims.keep, wanted)
                except OperationalError as error:
                    _LOG.warning("the database does not answer: %s", error.orig)
                else:
                    for job_id in [job_id for job_id, task in making.items() if task.done() or job_id not in ours]:
                        making[job_id].cancel()
                        await asyncio.wait([making.pop(job_id)])
                    turns = turns_of(wanted, turns)
                    for job_id in sorted(ours - making.keys(), key=lambda job_id: turns[job_id]):
                        calibrations_now = sum(kind_of(other) == CALIBRATION for other in making)
                        if kind_of(job_id) != CALIBRATION or calibrations_now < self._settings.calibrations_at_once:
                            making[job_id] = asyncio.create_task(self._make(client, job_id, -turns[job_id]))
                await self._pause()
        finally:
            for task in (watching, *making.values()):
                task.cancel()
            await asyncio.gather(watching, *making.values(), return_exceptions=True)
            claims.close()

    async def _pause(self) -> None:
        """Until there may be something to do."""
        if not self._stopping:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), _LOOK_S)
        self._wake.clear()

    async def _make(self, client: Client, job_id: str, priority: float) -> None:
        """Make one job, and note how it ended; what may end otherwise later is left for the next look."""
        try:
            summary = await self._made(client, job_id, priority)
            await asyncio.to_thread(self._finish, job_id, summary)
            self._wake.set()  # the next calibration may begin
        except Exception as error:
            await asyncio.to_thread(self._failed, job_id, error, lost=client.status != "running")

    def _finish(self, job_id: str, summary: dict[str, Any]) -> None:
        """Note a job as done and remove what it needed; in one go, as a service may stop as soon as it is noted."""
        if self._on_made is not None:
            self._on_made(job_id)  # first, because the checksums that are noted take a while
        self._store.finish(job_id, summary)
        self._store.tidy(job_id)

    async def _made(self, client: Client, job_id: str, priority: float) -> dict[str, Any]:
        """Make a job; what came out. Its progress is reported now and then."""
        kind: Any = calibrations if kind_of(job_id) == CALIBRATION else costmaps
        reported = 0.0

        async def _report(share: float) -> None:
            nonlocal reported
            if time.monotonic() - reported > _REPORT_S:
                await asyncio.to_thread(self._store.report, job_id, share)
                reported = time.monotonic()

        models_dir = self._settings.resolved_models_dir.resolve()
        order = await asyncio.to_thread(kind.order_of, self._store, job_id, models_dir)
        summary: dict[str, Any] = await kind.make(client, order, key=job_id, priority=priority, report=_report)
        return summary

    def _failed(self, job_id: str, error: Exception, *, lost: bool) -> None:
        """Leave a job for the next look where it is not its fault. lost : whether the scheduler was."""
        if lost or isinstance(error, (OperationalError, CancelledError)) or getattr(error, "errno", None) in _LATER:
            _LOG.warning("job %s waits and is tried again: %s", job_id, error)
            return
        if job_id not in self._store.wanted():
            _LOG.info("job %s is not wanted any more, and its error does not count: %s", job_id, error)
            return
        problem = error.problem if isinstance(error, Refused) else problem_of(error, job_id)
        if problem["status"] >= 500:
            _LOG.error("job %s failed", job_id, exc_info=error)
            self._failures[job_id] = self._failures.get(job_id, 0) + 1
            if self._failures[job_id] < _TRIES:
                return
        if self._store.fail(job_id, problem):
            self._store.discard(job_id, self._settings.resolved_models_dir)
