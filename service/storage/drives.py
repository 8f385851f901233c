"""Drives that are followed."""

from __future__ import annotations

import secrets
from typing import Any

from sqlalchemy import delete, select, update
from sqlalchemy.orm import defer

from joulemap.service.storage.kept import Kept, now
from joulemap.service.storage.tables import DRIVE, DriveRow

MOST_DRIVES = 1000
"""Of one owner; the oldest ones make room."""


class KeptDrives(Kept):
    """Rows of drives, each with all that is known of it."""

    def add_drive(
        self, costmap_id: str, request: dict[str, Any], state: dict[str, Any], forecast: dict[str, Any]
    ) -> DriveRow:
        """Add a drive over a cost map; the oldest of its owner are deleted beyond `MOST_DRIVES`."""
        row = DriveRow(
            id=f"{DRIVE}-{secrets.token_hex(6)}",
            created_at=now(),
            owner=self._caller.name,
            costmap_id=costmap_id,
            request=request,
            updates=0,
            unused=0,
            state=state,
            forecast=forecast,
        )
        with self._adding, self._sessions.begin() as session:
            its = select(DriveRow.id).where(DriveRow.owner == row.owner)
            older = session.scalars(its.order_by(DriveRow.created_at.desc()).offset(MOST_DRIVES - 1)).all()
            if older:
                session.execute(delete(DriveRow).where(DriveRow.id.in_(older)))
            session.add(row)
        return row

    def drive(self, drive_id: str) -> DriveRow:
        """Return the row of a drive. Raises NotFoundError if there is none."""
        return self._row(DriveRow, "is no drive", drive_id=drive_id)

    def drives(self, *, limit: int, offset: int) -> tuple[list[DriveRow], int]:
        """Return one page of the drives, newest first, without routes and states, and how many there are in all."""
        return self._page(DriveRow, limit, offset, defer(DriveRow.request), defer(DriveRow.state))

    def note_drive(self, row: DriveRow, state: dict[str, Any], forecast: dict[str, Any], unused: int) -> bool:
        """Replace what is known of a drive. Result: False, and nothing is replaced, where it has changed since."""
        then = update(DriveRow).where(DriveRow.id == row.id, DriveRow.updates == row.updates)
        with self._sessions.begin() as session:
            values = {"updates": row.updates + 1, "state": state, "forecast": forecast, "unused": unused}
            done = session.execute(then.values(values))
        return bool(done.rowcount)  # type: ignore[attr-defined]

    def delete_drive(self, drive_id: str) -> None:
        """Delete a drive. Raises NotFoundError if there is none."""
        row = self.drive(drive_id)
        with self._sessions.begin() as session:
            session.execute(delete(DriveRow).where(DriveRow.id == row.id))
