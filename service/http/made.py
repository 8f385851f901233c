"""What a service does with what it makes: answers which cost maps and calibrations are done, cancels, deletes."""

from __future__ import annotations

import time
from typing import TypeVar

from joulemap.model.errors import BusyError, ConflictError
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.retention import Retention
from joulemap.service.jobs.engine import Jobs
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CANCELLED, COSTMAP, DONE, FAILED, WORDS, CalibrationRow, CostmapRow

KNOWN_S = 2.0
"""So long a cost map that another service has deleted is still asked [s]."""
_MOST_KNOWN = 1_000

Job = TypeVar("Job", CostmapRow, CalibrationRow)


class Made:
    """Cost maps and calibrations."""

    settings: Settings
    store: Store
    jobs: Jobs
    maps: OpenMaps
    retention: Retention

    def __init__(self) -> None:
        self._known: dict[str, tuple[float, CostmapRow]] = {}  # a robot asks for the same map 200 times a second

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
