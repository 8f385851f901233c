"""One running service: its store, its jobs, its open cost maps, and whether its kernels are loaded."""

from __future__ import annotations

import copy
import gc
import logging
import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeVar

import anyio
from fastapi import Depends, Query, Request

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.errors import BusyError, ConflictError, InputError, JoulemapError
from joulemap.model.runs.odometry import Odometry
from joulemap.planner.plan import RoutePlanner
from joulemap.service.http.health import OK, Health
from joulemap.service.http.job_events import JobEvents, look_into
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.plans import plan_queue, price_queue
from joulemap.service.http.retention import Retention
from joulemap.service.http.watched import watch
from joulemap.service.intake.limits import ReadLimits, RunLimits
from joulemap.service.intake.readers import Readers
from joulemap.service.intake.runs import check_together
from joulemap.service.jobs.engine import Jobs
from joulemap.service.models import find_predictor
from joulemap.service.settings import Settings
from joulemap.service.storage.owners import NOBODY, Caller
from joulemap.service.storage.runs import safe_name
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    CANCELLED,
    COSTMAP,
    DONE,
    FAILED,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    RunsRow,
    kind_of,
)
from joulemap.service.workflows import warm_up

_LOG = logging.getLogger("joulemap.service")
_WARM_WAIT_S, _WARM_LOOK_S = 120.0, 0.05
_NEW_OBJECTS = 50_000
"""Until the collector looks for cycles: with Python's 700, two thirds of the time to read a long path go into that."""

Job = TypeVar("Job", CostmapRow, CalibrationRow)


class Service:
    """Everything that requests share; made with the app, started and stopped with it.

    Parameters
    ----------
    settings : Settings
        Limits and folders.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.version = version("joulemap")
        self.store = Store(settings.data_dir, settings.resolved_database_url, objects=settings.store)
        self.retention = Retention(
            settings, self.store, {CostmapRow: self.delete_costmap, CalibrationRow: self.delete_calibration}
        )
        self.maps = OpenMaps(
            self.store.load_lattice,
            size=settings.open_costmaps,
            place=lambda costmap_id: self.store.here(self.store.lattice_path(costmap_id)),
            most_cells=settings.max_cells_in_memory,
            memory_bytes=int(1e9 * settings.route_memory_gb),
        )
        self.metrics, self.health = Metrics(), Health()
        self.plans = plan_queue(settings, self.maps, self.metrics.saw_work)
        self.prices = price_queue(settings, self.maps, self.metrics.saw_work)
        self.job_events = JobEvents(look_into(self.store))
        queues = [self.plans, self.prices]
        watch(settings, self.store, health=self.health, metrics=self.metrics, maps=self.maps, queues=queues)
        self.jobs = Jobs(self.store, settings, on_done=self._open_made)
        self.health.add("workers", self._check_workers)
        if settings.store is not None:
            self.health.add("object store", self.store.vault.check)
        self.readers = Readers(
            processes=settings.read_processes,
            queue=settings.read_queue_size,
            limits=ReadLimits(settings.read_seconds, settings.read_memory_mb),
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
        self.warm_seconds: float | None = None
        self._warm = threading.Event()
        self._warm_failure = "see the log"

    def seen_by(self, caller: Caller) -> Service:
        """Return this service as a caller sees it.

        Parameters
        ----------
        caller : Caller
            On whose behalf it is asked.

        Returns
        -------
        Service
            With the same jobs and maps; what others own is not in its store.
        """
        seen = copy.copy(self)
        seen.store = self.store.seen_by(caller)
        return seen

    def find_predictor(self, model: str) -> Predictor:
        """Return a model that the caller may use.

        Parameters
        ----------
        model : str
            Its name, or the id of a calibration.

        Returns
        -------
        Predictor
            Ready to be asked.

        Raises
        ------
        ModelError
            If there is no such model, or if it belongs to another owner.
        """
        self.store.model_here(model, self.settings.resolved_models_dir)
        return find_predictor(model, models_dir=self.settings.resolved_models_dir, hidden=self.store.hidden_models())

    def start(self) -> None:
        """Open the store, load the kernels in a thread, and go on with unfinished jobs."""
        self.store.open()
        self.health.start()
        self.readers.start()
        threading.Thread(target=self._warm_up, name="warm-up", daemon=True).start()
        self.jobs.start()

    def stop(self) -> None:
        """Stop the workers and close the store."""
        self.health.stop()
        self.jobs.stop()
        self.readers.close()
        self.store.close()

    def check_ready(self) -> float:
        """Return how long loading the kernels took, from what is known already.

        Returns
        -------
        float
            Seconds.

        Raises
        ------
        BusyError
            If they are not loaded yet, if that failed, or if the latest look at something found that it is not well.
        """
        if self.warm_seconds is None:
            if self._warm.is_set():
                raise BusyError(f"not ready: loading failed: {self._warm_failure}", failed=True)
            raise BusyError("not ready: kernels are being compiled or loaded", failed=False, retry_after_s=2)
        checks = self.health.results()
        wrong = [f"{name}: {found}" for name, found in checks.items() if found != OK]
        if wrong:
            raise BusyError(f"not ready: {'; '.join(wrong)}", failed=False, checks=checks, retry_after_s=5)
        return self.warm_seconds

    def _check_workers(self) -> None:
        """Raise BusyError where nobody can do jobs."""
        if self.jobs.trouble is not None:
            raise BusyError(self.jobs.trouble, retry_after_s=10)

    async def kernels_loaded(self) -> None:
        """Wait until the kernels are loaded, without a thread.

        Raises
        ------
        BusyError
            If that takes too long.
        """
        with anyio.move_on_after(_WARM_WAIT_S):
            while not self._warm.is_set():
                await anyio.sleep(_WARM_LOOK_S)
        if not self._warm.is_set():
            raise BusyError("the service is still compiling its kernels", retry_after_s=10)

    def await_kernels(self) -> None:
        """Wait until the kernels are loaded.

        Raises
        ------
        BusyError
            If that takes too long.
        """
        if not self._warm.wait(_WARM_WAIT_S):
            raise BusyError("the service is still compiling its kernels", retry_after_s=10)

    async def keep_heightmap(self, path: Path, *, name: str, **options: Any) -> HeightmapRow:
        """Read, check and keep a heightmap that was sent.

        Parameters
        ----------
        path : Path
            The file.
        name : str
            Its name for people, whose ending may say the format.
        **options
            As those of `read_heightmap`.

        Returns
        -------
        HeightmapRow
            The new row.

        Raises
        ------
        HeightmapError
            If it is not a heightmap that can be used.
        TooLargeError
            If it has too many cells, or takes too much time or memory to read.
        BusyError
            If too many files wait to be read.
        """
        made = path.with_name(f"{path.name}.tif")
        most = self.settings.max_cells
        try:
            stats = await self.readers.read(
                "heightmap", path=str(path), out=str(made), name=name, max_cells=most, options=options
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
        heightmap_id: str | None = None,
        odometry: Odometry | None = None,
        mapping: Mapping[str, str] | None = None,
        accept_implausible: bool = False,
    ) -> RunsRow:
        """Read, check and keep runs that were sent together.

        Parameters
        ----------
        files : sequence of (str, Path)
            Name and file of each.
        heightmap_id : str, optional
            Id of the heightmap that they were driven on.
        odometry : Odometry, optional
            How runs without positions are read.
        mapping : mapping of str to str, optional
            Where columns are taken from, as `read_mapping` returns it.
        accept_implausible : bool, optional
            Whether runs are kept whose numbers are hardly in the units that they are read in.

        Returns
        -------
        RunsRow
            The new row. Runs in other formats, columns or units are kept in joulemap's, as CSV.

        Raises
        ------
        RunsError
            If a run cannot be read, contains no segment, or does not lie on the heightmap.
        TooLargeError
            If a run is larger than the limits, or takes too much time or memory to read.
        BusyError
            If too many files wait to be read.
        InputError
            If two runs have the same name.
        NotFoundError
            If there is no such heightmap.
        """
        names = _distinct([safe_name(name) for name, _ in files])
        ground = None
        if heightmap_id is not None:
            ground = (await anyio.to_thread.run_sync(self.store.heightmap, heightmap_id)).stats
        asked = {
            "limits_of_run": asdict(_run_limits(self.settings)),
            "crs": ground["crs"] if ground is not None else None,
            "odometry": asdict(odometry) if odometry is not None else None,
            "mapping": dict(mapping or {}),
            "accept_implausible": accept_implausible,
        }
        made = [path.with_name(f"{path.name}.csv") for _, path in files]
        try:
            stats = [
                await self.readers.read("run", path=str(path), name=name, out=str(out), **asked)
                for name, (_, path), out in zip(names, files, made, strict=True)
            ]
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

    def delete_costmap(self, costmap_id: str) -> None:
        """Delete a cost map; one that is being made is stopped.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        self.store.delete_costmap(costmap_id)
        self.maps.forget(costmap_id)

    def cancel(self, job_id: str) -> None:
        """Stop a job; its record stays, and what was made of it so far goes.

        Parameters
        ----------
        job_id : str
            Its id.

        Raises
        ------
        ConflictError
            If it is done or has failed.
        """
        if not self.store.cancel(job_id) and (status := self.store.status(job_id)) != CANCELLED:
            raise ConflictError(f"{job_id} is {status or 'deleted'}: there is nothing to cancel", status=status)
        self.jobs.submit()
        self.store.discard(job_id, self.settings.resolved_models_dir)

    def delete_calibration(self, calibration_id: str) -> None:
        """Delete a calibration with its report and its model; one that is being made is stopped.

        Parameters
        ----------
        calibration_id : str
            Its id.

        Raises
        ------
        NotFoundError
            If there is none.
        ConflictError
            If cost maps use its model.
        """
        self.store.delete_calibration(calibration_id)
        self.store.discard(calibration_id, self.settings.resolved_models_dir)

    def done_calibration(self, calibration_id: str) -> CalibrationRow:
        """Return the row of a calibration that is done.

        Parameters
        ----------
        calibration_id : str
            Its id.

        Returns
        -------
        CalibrationRow
            Whose report can be read.

        Raises
        ------
        NotFoundError
            If there is none.
        ConflictError
            If it is not done, or has failed.
        """
        return self._done(self.store.calibration(calibration_id), "calibration")

    def done_costmap(self, costmap_id: str) -> CostmapRow:
        """Return the row of a cost map that is done.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Returns
        -------
        CostmapRow
            Whose lattice can be loaded.

        Raises
        ------
        NotFoundError
            If there is none.
        ConflictError
            If it is not done, or has failed.
        """
        return self._done(self.store.costmap(costmap_id), "cost map")

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

    def _open_made(self, job_id: str) -> None:
        """Have a new cost map in memory before the first question."""
        if kind_of(job_id) == COSTMAP:
            with suppress(JoulemapError), self.maps.for_routes(job_id) as planner:
                if isinstance(planner, RoutePlanner):
                    planner.prepare()

    def _warm_up(self) -> None:
        try:
            for model in set(self.settings.warm_models).difference(MODEL_NAMES):  # the workers load them all
                self.find_predictor(model)
            self.warm_seconds = _kernels_loaded()
            _LOG.info("kernels are loaded after %.1f s", self.warm_seconds)
        except JoulemapError as error:
            self._warm_failure = error.message
            _LOG.error("loading the kernels failed: %s", error.message)
        finally:
            self._warm.set()


@cache
def _kernels_loaded() -> float:
    """Load the kernels, once for all services of a process; the time that it took [s]."""
    seconds = warm_up(models=())
    gc.collect()
    gc.freeze()  # a million objects of libraries that stay: to go over them again stalls everything for 0.5 s
    gc.set_threshold(_NEW_OBJECTS, *gc.get_threshold()[1:])
    return seconds


def _distinct(names: list[str]) -> list[str]:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise InputError(f"two runs are called {twice[0]}: send them under different names", name=twice[0])
    return names


def _run_limits(settings: Settings) -> RunLimits:
    return RunLimits(
        mb=settings.max_run_mb,
        rows=settings.max_run_rows,
        columns=settings.max_run_columns,
        cells=settings.max_run_cells,
        text_mb=settings.max_run_text_mb,
        km=settings.max_run_km,
    )


async def get_service(request: Request) -> Service:
    """Return the service of the app that answers a request (a FastAPI dependency), as its caller sees it.

    Parameters
    ----------
    request : Request
        The request at hand.

    Returns
    -------
    Service
        Started.
    """
    service: Service = request.app.state.service
    caller: Caller = request.state.caller
    return service if caller is NOBODY else service.seen_by(caller)


async def with_kernels(request: Request) -> Service:
    """Return the service once its kernels are loaded (a FastAPI dependency of routes that compute).

    Parameters
    ----------
    request : Request
        The request at hand.

    Returns
    -------
    Service
        Ready.

    Raises
    ------
    BusyError
        If loading takes too long.
    """
    service = await get_service(request)
    await service.kernels_loaded()
    return service


ServiceDep = Annotated[Service, Depends(get_service)]
KernelsDep = Annotated[Service, Depends(with_kernels)]
Limit = Annotated[int, Query(ge=1, le=1000, description="most items in the answer")]
Offset = Annotated[int, Query(ge=0, le=10**9, description="items to skip")]
