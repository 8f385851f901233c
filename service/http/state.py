"""One running service: its store, its jobs, its open cost maps, and whether its kernels are loaded."""

from __future__ import annotations

import copy
import logging
import threading
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeVar

import anyio
from fastapi import Depends, Query, Request

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import BusyError, ConflictError, JoulemapError
from joulemap.model.runs.odometry import Odometry
from joulemap.model.terrain.readers import read_heightmap
from joulemap.service.http.intake import RunLimits, read_sent_runs
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.jobs.makers import make_makers
from joulemap.service.jobs.worker import SERVICE, Jobs, Worker
from joulemap.service.models import find_predictor
from joulemap.service.settings import Settings
from joulemap.service.storage.owners import NOBODY, Caller
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CALIBRATION, DONE, FAILED, CalibrationRow, CostmapRow, HeightmapRow, RunsRow
from joulemap.service.workflows import warm_up

_LOG = logging.getLogger("joulemap.service")
_WARM_WAIT_S = 120.0
_INGEST_AT_ONCE = 2

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
        self.store = Store(settings.data_dir, settings.resolved_database_url)
        self.maps = OpenMaps(
            self.store.load_lattice,
            size=settings.open_costmaps,
            place=self.store.lattice_path,
            most_cells=settings.max_cells_in_memory,
            memory_bytes=int(1e9 * settings.route_memory_gb),
        )
        self.makers = make_makers(self.store, settings, on_done=self.maps.keep)
        workers = [  # one for each kind, so that a long calibration keeps no cost map waiting
            Worker(self.store, {kind: maker}, name=SERVICE, ready=self.await_kernels)
            for kind, maker in self.makers.items()
            if settings.build_here
        ]
        self.jobs = Jobs(self.store, workers, queue_size=settings.queue_size)
        self.ingest_limit = anyio.CapacityLimiter(_INGEST_AT_ONCE)  # each may hold a whole heightmap
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
        return find_predictor(model, models_dir=self.settings.resolved_models_dir, hidden=self.store.hidden_models())

    def start(self) -> None:
        """Open the store, load the kernels in a thread, and go on with unfinished jobs."""
        self.store.open()
        threading.Thread(target=self._warm_up, name="warm-up", daemon=True).start()
        self.jobs.resume()

    def stop(self) -> None:
        """Stop the workers and close the store."""
        self.jobs.stop()
        self.store.close()

    def check_ready(self) -> float:
        """Return how long loading the kernels took.

        Returns
        -------
        float
            Seconds.

        Raises
        ------
        BusyError
            If they are not loaded yet, or if that failed.
        """
        if self.warm_seconds is None:
            if self._warm.is_set():
                raise BusyError(f"not ready: loading failed: {self._warm_failure}", failed=True)
            raise BusyError("not ready: kernels are being compiled or loaded", failed=False, retry_after_s=2)
        return self.warm_seconds

    def await_kernels(self) -> None:
        """Wait until the kernels are loaded.

        Raises
        ------
        BusyError
            If that takes too long.
        """
        if not self._warm.wait(_WARM_WAIT_S):
            raise BusyError("the service is still compiling its kernels", retry_after_s=10)

    def keep_heightmap(self, path: Path, *, name: str, **options: Any) -> HeightmapRow:
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
            If it has too many cells.
        """
        heightmap = read_heightmap(path, filename=name, max_cells=self.settings.max_cells, **options)
        known = heightmap.heights[heightmap.heights == heightmap.heights]
        frame = heightmap.frame
        stats = {
            "rows": frame.rows,
            "cols": frame.cols,
            "resolution_m": frame.resolution_m,
            "crs": frame.crs,
            "bounds": list(frame.bounds),
            "known_share": heightmap.known_share,
            "height_min_m": float(known.min()),
            "height_max_m": float(known.max()),
            "hash": heightmap.data_hash,
            "band": options.get("band"),
        }
        return self.store.add_heightmap(heightmap, name=name, stats=stats)

    def keep_runs(
        self, files: Sequence[tuple[str, Path]], *, heightmap_id: str | None = None, odometry: Odometry | None = None
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

        Returns
        -------
        RunsRow
            The new row.

        Raises
        ------
        RunsError
            If a run cannot be read, contains no segment, or does not lie on the heightmap.
        TooLargeError
            If a run is larger than the limits.
        InputError
            If two runs have the same name.
        NotFoundError
            If there is no such heightmap.
        """
        settings = self.settings
        heightmap = self.store.heightmap(heightmap_id) if heightmap_id is not None else None
        limits = RunLimits(settings.max_run_mb, settings.max_run_cells, settings.max_run_km)
        ground = heightmap.stats if heightmap is not None else None
        stats = read_sent_runs(files, limits=limits, ground=ground, odometry=odometry)
        return self.store.add_runs(files, stats)

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
        self.makers[CALIBRATION].discard(calibration_id)

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
        if row.status != DONE:
            raise ConflictError(
                f"{what} {row.id} is {row.status} ({row.progress:.0%}): ask again when it is done",
                status=row.status,
                progress=row.progress,
                retry_after_s=2,
            )
        return row

    def _warm_up(self) -> None:
        try:
            settings = self.settings
            self.warm_seconds = warm_up(models=settings.warm_models, models_dir=settings.resolved_models_dir)
            _LOG.info("kernels are loaded after %.1f s", self.warm_seconds)
        except JoulemapError as error:
            self._warm_failure = error.message
            _LOG.error("loading the kernels failed: %s", error.message)
        finally:
            self._warm.set()


def get_service(request: Request) -> Service:
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


def with_kernels(request: Request) -> Service:
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
    service = get_service(request)
    service.await_kernels()
    return service


ServiceDep = Annotated[Service, Depends(get_service)]
KernelsDep = Annotated[Service, Depends(with_kernels)]
Limit = Annotated[int, Query(ge=1, le=1000, description="most items in the answer")]
Offset = Annotated[int, Query(ge=0, le=10**9, description="items to skip")]
