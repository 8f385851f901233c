"""One running service: its store, its jobs, its open cost maps, and whether it is ready."""

from __future__ import annotations

import asyncio
import copy
import logging
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import anyio

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.errors import BusyError, ConflictError, InputError, JoulemapError, NotFoundError
from joulemap.model.runs.files import same_content
from joulemap.service.hosting.settings import Settings
from joulemap.service.hosting.system import give_back_freed_memory
from joulemap.service.http.access import AtOnce
from joulemap.service.http.driving import Drives, look_at_drives
from joulemap.service.http.job_events import JobEvents, look_into
from joulemap.service.http.kernels import Kernels
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.open_maps import KeptAnswers, OpenMaps
from joulemap.service.http.retention import Retention
from joulemap.service.http.watched import NOT_YET, OK, Health, ScheduledCheck, watch
from joulemap.service.http.work_queue import queues
from joulemap.service.intake.limits import ReadLimits, RunLimits, RunReading
from joulemap.service.intake.readers import Readers
from joulemap.service.intake.runs import check_together
from joulemap.service.jobs.engine import Jobs
from joulemap.service.models import find_predictor
from joulemap.service.storage.owners import Caller
from joulemap.service.storage.sent import safe_name
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    CANCELLED,
    COSTMAP,
    DONE,
    FAILED,
    WORDS,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    RunsRow,
    kind_of,
)

KNOWN_S = 2.0
"""So long a cost map that another service has deleted is still asked [s]."""
_MOST_KNOWN = 1_000

Job = TypeVar("Job", CostmapRow, CalibrationRow)
_LOG = logging.getLogger("joulemap.service")


class Service:
    """Everything that requests share; made with the app, started and stopped with it."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._known: dict[str, tuple[float, CostmapRow]] = {}  # a robot asks for the same map 200 times a second
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

    async def keep_heightmap(self, path: Path, *, name: str, **options: Any) -> HeightmapRow:
        """Read, check and keep a heightmap that was sent."""
        made = path.with_name(f"{path.name}.tif")
        most = self.settings.max_cells
        try:
            stats = await self.readers.read(
                "heightmap",
                owner=self.store.owner,
                path=str(path),
                out=str(made),
                name=name,
                max_cells=most,
                options=options,
            )

            def _keep() -> HeightmapRow:
                return self.store.add_heightmap(made, name=name, stats=stats)

            return await anyio.to_thread.run_sync(_keep)
        finally:
            for left in path.parent.glob(f"*{made.name}*"):  # the map, or what a process that was killed had written
                left.unlink(missing_ok=True)

    async def keep_runs(
        self,
        files: Sequence[tuple[str, Path]],
        *,
        reading: RunReading,
        heightmap_id: str | None = None,
    ) -> RunsRow:
        """Read, check and keep runs that were sent together.

        Result: runs in other formats, columns or units are kept in joulemap's, as CSV. Raises NotFoundError if there is
        no such heightmap.
        """
        copies = await anyio.to_thread.run_sync(same_content, [path for _, path in files])
        called = {path: name for name, path in files}
        again = {called[first]: [called[copy] for copy in copies if copies[copy] == first] for first in copies.values()}
        files = [(name, path) for name, path in files if path not in copies]
        names = _distinct([safe_name(name) for name, _ in files])
        ground = None
        if heightmap_id is not None:
            ground = (await anyio.to_thread.run_sync(self.store.heightmap, heightmap_id)).stats
        asked: dict[str, Any] = {
            "limits_of_run": asdict(_run_limits(self.settings)),
            "owner": self.store.owner,
            "crs": ground["crs"] if ground is not None else None,
            "reading": reading.as_dict(),
        }
        made = [path.with_name(f"{path.name}.csv") for _, path in files]
        try:
            stats = [
                await self.readers.read("run", path=str(path), name=name, out=str(out), **asked)
                for name, (_, path), out in zip(names, files, made, strict=True)
            ]
            for (name, _), one in zip(files, stats, strict=True):
                if name in again:
                    one["warnings"].append(f"it was sent again as {', '.join(again[name][:3])}: it is kept once")
            check_together(stats, ground)
            kept = [
                (name, out if one.pop("written") else path)
                for (name, path), out, one in zip(files, made, stats, strict=True)
            ]
            return await anyio.to_thread.run_sync(self.store.add_runs, kept, stats)
        finally:
            for out in made:  # or what a process that was killed had written
                out.unlink(missing_ok=True)
                out.with_name(f"{out.name}.part").unlink(missing_ok=True)

    def check_room(self, kind: str = COSTMAP) -> None:
        """Check that one more job may be added."""
        waiting, limit = len(self.store.unfinished(kind)), self.settings.queue_size
        if waiting >= limit:
            raise BusyError(
                f"the queue is full: {WORDS[kind]}s that wait or run: {waiting}, limit: {limit}",
                waiting=waiting,
                limit=limit,
                retry_after_s=10,
            )

    def done_costmap(self, costmap_id: str) -> CostmapRow:
        """Return the row of a cost map that is done.

        Whose lattice can be loaded. Raises NotFoundError if there is none; ConflictError if it is not done, or has
        failed.
        """
        read_at, row = self._known.get(costmap_id, (-KNOWN_S, None))
        if row is None or time.monotonic() - read_at > KNOWN_S or not self.store.may_see(row):
            row = self.store.costmap(costmap_id)
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            if row.status == DONE:
                self._known[costmap_id] = time.monotonic(), row
        return self._done(row, "cost map")

    def done_calibration(self, calibration_id: str) -> CalibrationRow:
        """Return the row of a calibration that is done.

        Whose report can be read. Raises NotFoundError if there is none; ConflictError if it is not done, or has failed.
        """
        return self._done(self.store.calibration(calibration_id), "calibration")

    def cancel(self, job_id: str) -> None:
        """Stop a job; its record stays, and what was made of it so far goes.

        Raises ConflictError if it is done or has failed.
        """
        if not self.store.cancel(job_id) and (status := self.store.status(job_id)) != CANCELLED:
            raise ConflictError(f"{job_id} is {status or 'deleted'}: there is nothing to cancel", status=status)
        self.jobs.submit()
        self.store.discard(job_id, self.settings.resolved_models_dir)

    def delete_costmap(self, costmap_id: str) -> None:
        """Delete a cost map; one that is being made is stopped. Raises NotFoundError if there is none."""
        self.store.delete_costmap(costmap_id)
        self._known.pop(costmap_id, None)
        self.maps.forget(costmap_id)

    def delete_calibration(self, calibration_id: str) -> None:
        """Delete a calibration with its report and its model; one that is being made is stopped.

        Raises NotFoundError if there is none; ConflictError if cost maps use its model.
        """
        self.store.delete_calibration(calibration_id)
        self.store.discard(calibration_id, self.settings.resolved_models_dir)

    def _done(self, row: Job, what: str) -> Job:
        if row.status == FAILED:
            detail = (row.problem or {}).get("detail", "no reason is known")
            raise ConflictError(f"{what} {row.id} could not be made: {detail}", status=row.status, problem=row.problem)
        if row.status == CANCELLED:
            raise ConflictError(f"{what} {row.id} was cancelled at {row.progress:.0%}", status=row.status)
        if row.status != DONE:
            raise ConflictError(
                f"{what} {row.id} is {row.status} ({row.progress:.0%}): ask again when it is done",
                status=row.status,
                progress=row.progress,
                retry_after_s=2,
            )
        self.retention.saw(row.id)
        return row


def _distinct(names: list[str]) -> list[str]:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise InputError(f"two runs are called {twice[0]}: send them under different names", name=twice[0])
    return names


def _run_limits(settings: Settings) -> RunLimits:
    table = {name: getattr(settings, f"max_run_{name}") for name in ("rows", "columns", "cells", "text_mb")}
    return RunLimits(settings.max_run_mb, settings.max_run_km, table)
