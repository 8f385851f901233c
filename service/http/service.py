"""One running service: its store, its jobs, its open cost maps, and whether it is ready."""

from __future__ import annotations

import asyncio
import copy
import logging
import tempfile
from contextlib import suppress
from importlib.metadata import version

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.errors import BusyError, JoulemapError, NotFoundError
from joulemap.service.hosting.memory import give_back_freed_memory
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.access_at_once import AtOnce
from joulemap.service.http.driving import Drives, look_at_drives
from joulemap.service.http.health import NOT_YET, OK, Health
from joulemap.service.http.job_events import JobEvents, look_into
from joulemap.service.http.kept_answers import KeptAnswers
from joulemap.service.http.kernels import Kernels
from joulemap.service.http.made import Made
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.plans import queues
from joulemap.service.http.retention import Retention
from joulemap.service.http.scheduled_check import ScheduledCheck
from joulemap.service.http.sent_files import SentFiles
from joulemap.service.http.watched import watch
from joulemap.service.intake.limits import ReadLimits
from joulemap.service.intake.readers import Readers
from joulemap.service.jobs.engine import Jobs
from joulemap.service.models import find_predictor
from joulemap.service.storage.owners import Caller
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import COSTMAP, CalibrationRow, CostmapRow, kind_of

_LOG = logging.getLogger("joulemap.service")


class Service(SentFiles, Made):
    """Everything that requests share; made with the app, started and stopped with it."""

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.settings = settings
        self.version = version("joulemap")
        self._served = not settings.resolved_database_url.startswith("sqlite")
        self.store = Store(
            settings.data_dir,
            settings.resolved_database_url,
            objects=settings.store,
            least_free_bytes=int(1e6 * settings.min_free_mb),
        )
        self.retention = Retention(
            settings, self.store, {CostmapRow: self.delete_costmap, CalibrationRow: self.delete_calibration}
        )
        self.maps = OpenMaps(
            self.store.load_lattice,
            size=settings.open_costmaps,
            place=self.store.lattice_folder,
            status=self.store.status,
            most_cells=settings.max_cells_in_memory,
            memory_bytes=int(1e9 * settings.route_memory_gb),
        )
        self.metrics, self.health = Metrics(), Health()
        self.queues = queues(settings, self.maps, self.metrics.saw_work)
        self.plans, self.prices = (queue.of(None) for queue in self.queues)
        self.job_events = JobEvents(look_into(self.store))
        self.drive_events = JobEvents(look_at_drives(self.store))
        self.drives, self.answers = Drives(self.maps), KeptAnswers()
        self.answered = AtOnce("connections", settings.most_client_connections, "JOULEMAP_CLIENT_CONNECTIONS")
        self.streams = AtOnce("event streams", settings.most_client_streams, "JOULEMAP_CLIENT_STREAMS")
        watch(settings, self.store, health=self.health, metrics=self.metrics, maps=self.maps, queues=self.queues)
        self.jobs = Jobs(self.store, settings, on_made=self._open_made)
        self.health.add("workers", self._check_workers)
        if settings.store is not None:
            self.health.add("object store", self.store.vault.check)
        self.readers = Readers(
            processes=settings.read_processes,
            queue=settings.read_queue_size,
            limits=ReadLimits(settings.read_seconds, settings.read_memory_mb),
            scratch=lambda: self.store.uploads,
        )
        self.metrics.gauge(
            "joulemap_sent_files_waiting", "sent files that wait to be read", lambda: float(self.readers.waiting)
        )
        self.metrics.gauge(
            "joulemap_sent_files_running", "sent files that are read now", lambda: float(self.readers.running)
        )
        self.metrics.counter(
            "joulemap_sent_files_refused_total", "refused: the queue was full", lambda: float(self.readers.refused)
        )
        self.check = ScheduledCheck(settings, self.store)
        self.metrics.gauge(
            "joulemap_check_findings", "what the latest scheduled check found wrong", lambda: float(self.check.found)
        )
        self.kernels = Kernels()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._scratch = ""

    def seen_by(self, caller: Caller) -> Service:
        """Return this service as a caller sees it.

        Result: with the same jobs and maps; what others own is not in its store.
        """
        seen = copy.copy(self)
        seen.store = self.store.seen_by(caller)
        seen.plans, seen.prices = (queue.of(caller.name) for queue in self.queues)
        return seen

    def find_predictor(self, model: str) -> Predictor:
        """Return a model that the caller may use."""
        self.store.model_here(model, self.settings.resolved_models_dir)
        return find_predictor(model, models_dir=self.settings.resolved_models_dir, hidden=self.store.hidden_models())

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Open the store, load the kernels in a thread, and go on with unfinished jobs."""
        self._loop = loop
        self.store.open()
        tempfile.tempdir = self._scratch = str(self.store.uploads)  # forms and files that are made need it, by and by
        self.health.start()
        self.check.start()
        self.readers.start()
        self.kernels.load(self._find_warm_models)
        self.jobs.start()

    def stop(self) -> None:
        """Stop the workers and close the store."""
        self.health.stop()
        self.check.stop()
        self.kernels.stop()
        self.jobs.stop()
        self.readers.close()
        if tempfile.tempdir == self._scratch:
            tempfile.tempdir = None
        self.store.close()

    def check_ready(self) -> float:
        """Return how long loading the kernels took, from what is known already."""
        seconds = self.kernels.check()
        checks = self.health.results()
        wrong = [f"{name}: {found}" for name, found in checks.items() if found != OK]
        if wrong:
            raise BusyError(f"not ready: {'; '.join(wrong)}", failed=False, checks=checks, retry_after_s=5)
        return seconds

    def database_is_away(self) -> bool:
        """Return whether the latest look at a database that other programs serve found none, without looking again.

        Result: False for SQLite, which is a file and answers or fails at once.
        """
        return self._served and self.health.results()["database"] not in (OK, NOT_YET)

    def end_events(self) -> None:
        """End all streams of events, because the server stops."""
        self.job_events.end()
        self.drive_events.end()

    def _check_workers(self) -> None:
        """Raise BusyError where nobody can do jobs."""
        if self.jobs.trouble is not None:
            raise BusyError(self.jobs.trouble, retry_after_s=10)

    def _open_made(self, job_id: str) -> None:
        """Have a new cost map in memory before the first question, in turn with the questions of others."""

        def _open() -> None:
            with suppress(JoulemapError), self.maps.for_routes(job_id) as planner:
                planner.prepare()
            try:
                self.store.costmap(job_id)
            except NotFoundError:  # it was deleted before it could be noted as done
                self.maps.forget(job_id)
            give_back_freed_memory()  # of the map that had to go

        async def _in_turn() -> None:
            try:
                await self.plans.do(job_id, _open)
            except BusyError as error:
                _LOG.info("cost map %s is opened by its first question: %s", job_id, error)
            except Exception:
                _LOG.exception("cost map %s could not be opened before its first question", job_id)

        if kind_of(job_id) == COSTMAP and self._loop is not None:
            asyncio.run_coroutine_threadsafe(_in_turn(), self._loop)

    def _find_warm_models(self) -> None:
        for model in set(self.settings.warm_models).difference(MODEL_NAMES):  # the workers load them all
            self.find_predictor(model)
