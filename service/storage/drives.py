"""Drives that are followed."""

from __future__ import annotations

import secrets
from typing import Any

from sqlalchemy import bindparam, delete, select, update
from sqlalchemy.orm import defer

from joulemap.service.storage.kept import Kept, now
from joulemap.service.storage.tables import DRIVE, DriveRow

MOST_DRIVES = 1000
"""Of one owner; the oldest ones make room."""
_NOTED = (
    update(DriveRow)
    .where(DriveRow.id == bindparam("of"), DriveRow.updates == bindparam("known"))
    .values({"updates": DriveRow.updates + 1, **{name: bindparam(name) for name in ("state", "forecast", "unused")}})
)
_LONG = defer(DriveRow.request), defer(DriveRow.state)


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

    def drive(self, drive_id: str, *, whole: bool = True) -> DriveRow:
        """Return the row of a drive; if it need not be whole, without route, state and forecast, which take longer to
        read than all else of an update. Raises NotFoundError if there is none.
        """
        options = () if whole else (*_LONG, defer(DriveRow.forecast))
        return self._row(DriveRow, "is no drive", *options, drive_id=drive_id)

    def drives(self, *, limit: int, offset: int, costmap_id: str | None = None) -> tuple[list[DriveRow], int]:
        """Return one page of the drives, newest first, without routes and states, and how many there are in all."""
        over = [] if costmap_id is None else [DriveRow.costmap_id == costmap_id]
        return self.page(DriveRow, limit, offset, *_LONG, where=over)

    def note_drive(self, row: DriveRow, state: dict[str, Any], forecast: dict[str, Any], unused: int) -> bool:
        """Replace what is known of a drive. Result: False, and nothing is replaced, where it has changed since."""
        values = {"of": row.id, "known": row.updates, "state": state, "forecast": forecast, "unused": unused}
        # in turn: SQLite has one writer, and others look again only after up to 0.1 s
        with self._adding, self.engine.begin() as connection:
            return bool(connection.execute(_NOTED, values).rowcount)

    def delete_drive(self, drive_id: str) -> None:
        """Delete a drive. Raises NotFoundError if there is none."""
        row = self.drive(drive_id)
        with self._sessions.begin() as session:
            session.execute(delete(DriveRow).where(DriveRow.id == row.id))
