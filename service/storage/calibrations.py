"""Calibrations that are kept."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select

from joulemap.model.errors import ConflictError
from joulemap.service.storage.jobs import KeptJobs, new_job
from joulemap.service.storage.tables import (
    CALIBRATION,
    CalibrationRow,
    CostmapRow,
)


class KeptCalibrations(KeptJobs):
    """Rows of calibrations, and a report of each that is done."""

    def add_calibration(self, heightmap_id: str | None, request: dict[str, Any]) -> CalibrationRow:
        """Add a calibration to the queue.

        `heightmap_id`: id of the heightmap that the runs were driven on, None for runs without positions. Raises
        NotFoundError if the heightmap was deleted.
        """
        return self._add(CalibrationRow(**new_job(CALIBRATION, heightmap_id, request)))

    def calibration(self, calibration_id: str) -> CalibrationRow:
        """Return the row of a calibration. Raises NotFoundError if there is none."""
        return self._row(CalibrationRow, "is no calibration", calibration_id=calibration_id)

    def calibrations(self, *, limit: int, offset: int) -> tuple[list[CalibrationRow], int]:
        """Return one page of the calibrations, newest first.

        Returns `rows`: those of the page; `total`: how many there are in all.
        """
        return self._page(CalibrationRow, limit, offset)

    def hidden_models(self) -> set[str]:
        """Return the models that the caller must not see. Result: ids of the calibrations that others own."""
        if self._caller.sees_all:
            return set()
        with self._sessions() as session:
            ids = select(CalibrationRow.id)
            return set(session.scalars(ids)) - set(session.scalars(self._caller.own(ids, CalibrationRow)))

    def delete_calibration(self, calibration_id: str) -> None:
        """Delete the row of a calibration; its files are the caller's to delete.

        Raises NotFoundError if there is none; ConflictError if cost maps use its model; their ids are in the context.
        """
        row = self.calibration(calibration_id)
        with self._sessions() as session:
            query = select(CostmapRow.id).where(CostmapRow.request["model"].as_string() == calibration_id)
            users = sorted(session.scalars(query))
        if users:
            raise ConflictError(
                f"the model of calibration {calibration_id} is used by {len(users)} cost map(s), "
                f"{', '.join(users[:5])}: delete them first",
                costmap_ids=users,
            )
        self._delete(lambda session: session.delete(row))
