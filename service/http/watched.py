"""What a service looks at regularly and tells: readiness, numbers for Prometheus, `joulemap check` on a schedule."""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError

from joulemap.model.errors import JoulemapError
from joulemap.service.hosting.settings import Settings
from joulemap.service.hosting.system import JOB_NICE, be_nice
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.work_queue import WorkQueue
from joulemap.service.problems import without_places
from joulemap.service.schemas.kept import ANSWERS
from joulemap.service.storage.check import Check
from joulemap.service.storage.files import bytes_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import JOBS, WORDS

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


_LOG = logging.getLogger("joulemap.service")


class ScheduledCheck:
    """Looks through the data directory every `check_every_h` hours, on a thread that lets others go first."""

    def __init__(self, settings: Settings, store: Store) -> None:
        self._settings, self._store, self._over = settings, store, threading.Event()
        self.found = 0
        """How much was wrong at the latest look."""

    def start(self) -> None:
        """Begin to wait for the first look, where one is wanted."""
        if self._settings.check_every_h is not None:
            threading.Thread(target=self._repeat, name="check", daemon=True).start()

    def stop(self) -> None:
        """End; a look ends before its next row."""
        self._over.set()

    def _repeat(self) -> None:
        be_nice(JOB_NICE)
        while not self._over.wait(3600.0 * (self._settings.check_every_h or 0.0)):
            try:
                self._look()
            except (SQLAlchemyError, OSError) as error:  # a database or an object store that is away, or a stop
                _LOG.warning("the check of what is kept did not end: %s", error)

    def _look(self) -> None:
        settings, found = self._settings, 0
        looking = Check(self._store, settings.data_dir, settings.resolved_models_dir, answers=ANSWERS)
        for finding in looking.findings():
            if self._over.is_set():
                return
            found += 1
            remedy = (
                "restore it from a backup" if finding.remedy is None else "stop the service, `joulemap check --repair`"
            )
            _LOG.error("check: %s: %s: %s (%s)", finding.kind, finding.what, finding.words, remedy)
        self.found = found
        _LOG.info("check: %s", f"{found} findings" if found else "nothing is wrong")


_FOLDERS_S = 300.0  # between looks at the sizes of all files, of which there may be many


class Looked:
    """What the latest looks at the database and the data directory found."""

    def __init__(self, store: Store, folder: Path) -> None:
        self._store, self._folder = store, folder
        self.jobs: dict[tuple[str, str], int] = {}
        self.bytes: dict[str, int] = {}

    def at_database(self) -> None:
        """Count the jobs."""
        found: dict[tuple[str, str], int] = {}
        try:
            with self._store.sessions() as session:
                for kind, table in JOBS.items():
                    rows: Any = session.execute(select(table.status, func.count()).group_by(table.status))
                    found |= {(WORDS[kind], status): count for status, count in rows}
        except SQLAlchemyError as error:
            raise OSError(f"the database does not answer: {getattr(error, 'orig', error)}"[:300]) from error
        self.jobs = found

    def at_files(self) -> None:
        """Sum the sizes of all files."""
        self.bytes = {place.name: bytes_of(place) for place in self._folder.iterdir() if place.is_dir()}


def watch(
    settings: Settings, store: Store, *, health: Health, metrics: Metrics, maps: OpenMaps, queues: list[WorkQueue]
) -> None:
    """Add the checks and the numbers that every service has."""
    looked = Looked(store, settings.data_dir)
    health.add("database", looked.at_database)
    health.add(
        "disk",
        disk_check(settings.data_dir, least_free_bytes=int(settings.min_free_mb * 1e6), ok=store.room.keep_reserve),
    )
    health.add("files", looked.at_files, every_s=_FOLDERS_S)
    metrics.queues(queues)
    metrics.gauge("joulemap_open_costmaps", "cost maps in memory", lambda: float(len(maps)))
    metrics.counter("joulemap_costmap_cache_hits_total", "questions that found their map", lambda: float(maps.hits))
    metrics.counter("joulemap_costmap_cache_misses_total", "questions that had to load it", lambda: float(maps.misses))
    metrics.gauge(
        "joulemap_check_passed",
        "1 where the latest look found all well, else 0",
        lambda: {name: float(found == OK) for name, found in health.results().items()},
        labels=("check",),
    )
    metrics.gauge(
        "joulemap_jobs",
        "jobs by kind and status",
        lambda: {key: float(count) for key, count in looked.jobs.items()},
        labels=("kind", "status"),
    )
    metrics.gauge(
        "joulemap_data_bytes",
        "size of the files in the data directory, by folder",
        lambda: {name: float(size) for name, size in looked.bytes.items()},
        labels=("folder",),
    )


@asynccontextmanager
async def on_the_loop(metrics: Metrics, queues: Iterable[WorkQueue]) -> AsyncIterator[None]:
    """Measure the event loop's stalls meanwhile, and end the work of all queues at the end."""
    watching = asyncio.create_task(metrics.watch_loop())
    try:
        yield
    finally:
        for queue in queues:
            queue.stop()
        watching.cancel()
