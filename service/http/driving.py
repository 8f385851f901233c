"""The drives that are followed now: each is kept in the database at every update, and its route here.

So any service over the same database takes the next update, and a killed one has lost nothing that it acknowledged.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from sqlalchemy import select

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.driving.ahead import check_points
from joulemap.service.driving.updated import BetterRoute, better_route
from joulemap.service.http.job_events import JobState, Look
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.library.drive import Drive
from joulemap.service.places.places import Places
from joulemap.service.questions.drive import DriveRequest, UpdateRequest
from joulemap.service.questions.parts import battery_of
from joulemap.service.schemas.driving import DriveOut, drive_out
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import RUNNING, DriveRow

_OPEN, _OPEN_M = 256, 200_000.0
"""Settings: drives whose routes are kept in memory, and the length of these together [m], which takes 40 MB. More of
them are followed as well: a route that is not there is priced again at its next update."""
_TRIES = 5


def look_at_drives(store: Store) -> Look:
    """Return a look at drives: the progress of each is the number of its updates."""

    def _look(ids: Collection[str]) -> Mapping[str, JobState]:
        with store.sessions() as session:
            rows = session.execute(select(DriveRow.id, DriveRow.updates).where(DriveRow.id.in_(ids)))
            return {drive_id: JobState(RUNNING, float(updates)) for drive_id, updates in rows}

    return _look


class _Open:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.drive: Drive | None = None
        self.row: DriveRow | None = None
        self.updates = -1


class Drives:
    """Follows drives over cost maps."""

    def __init__(self, maps: OpenMaps) -> None:
        self._maps = maps
        self._lock = threading.Lock()
        self._open: OrderedDict[str, _Open] = OrderedDict()

    def begin(self, store: Store, costmap_id: str, wanted: DriveRequest) -> DriveRow:
        """Begin to follow a drive."""
        with self._maps.for_pricing(costmap_id) as planner:
            points = Places(planner.lattice.frame).path(wanted.path)
        battery = None if wanted.battery is None else wanted.battery.model_dump(exclude_none=True)
        request = {"path": points.tolist(), "battery": battery}
        drive = self._made(costmap_id, request)
        row = store.add_drive(costmap_id, request, drive.as_dict(), drive.forecast().as_dict())
        known = self._known(row.id)
        known.drive, known.row, known.updates = drive, row, row.updates
        return row

    def update(self, store: Store, drive_id: str, wanted: UpdateRequest) -> DriveOut:
        """Take in samples, and return the drive with its new forecast once both are kept.

        The database is read only where others have updated the drive since.
        """
        known = self._known(drive_id)
        with known.lock:
            for _ in range(_TRIES):
                drive, row = self._current(store, drive_id, known, read=known.updates < 0)
                known.updates = -1  # until what follows is kept
                drive.take(wanted.samples)
                state, forecast = drive.as_dict(), drive.forecast().as_dict()
                if store.note_drive(row, state, forecast, drive.tracking.unused):
                    known.updates = row.updates = row.updates + 1
                    row.forecast, row.unused = forecast, drive.tracking.unused
                    return drive_out(row)
        raise ConflictError(f"drive {drive_id} is updated by others at the same moment: send the samples again")

    @contextmanager
    def as_it_is(self, store: Store, drive_id: str) -> Iterator[Drive]:
        """Lend a drive as it was kept last; it takes no samples meanwhile."""
        known = self._known(drive_id)
        with known.lock:
            yield self._current(store, drive_id, known)[0]

    def better(self, store: Store, drive_id: str) -> BetterRoute | None:
        """Look for another way to the goal of a drive, which takes samples meanwhile."""
        with self._maps.for_routes(self._row(store, drive_id, whole=False).costmap_id) as planner:
            planner.needs_memory("a better route for a drive")
        with self.as_it_is(store, drive_id) as drive:
            known, rest = drive.tracking.known(), drive.rest()
        return better_route(drive.lattice, known, rest)

    def known_row(self, store: Store, drive_id: str) -> DriveRow | None:
        """Return the row of a drive as it was read last, if it is in memory and the caller may see it."""
        row = known.row if (known := self._open.get(drive_id)) else None
        return row if row and store.may_see(row) else None

    def _current(self, store: Store, drive_id: str, known: _Open, *, read: bool = True) -> tuple[Drive, DriveRow]:
        """The drive as its row says, and the row, which is read again if it is to be; the lock of `known` is held."""
        row = (None if read else self.known_row(store, drive_id)) or self._row(store, drive_id, whole=False)
        if known.drive is None or known.updates != row.updates:
            row = self._row(store, drive_id, whole=True)
            known.drive = known.drive or self._made(row.costmap_id, row.request)
            known.drive.restore(row.state)
            known.updates = row.updates
        known.row = row
        return known.drive, row

    def forget(self, drive_id: str) -> None:
        """Keep nothing of a drive in memory: it was deleted."""
        with self._lock:
            self._open.pop(drive_id, None)

    def _row(self, store: Store, drive_id: str, *, whole: bool) -> DriveRow:
        try:
            return store.drive(drive_id, whole=whole)
        except NotFoundError:
            self.forget(drive_id)
            raise

    def _made(self, costmap_id: str, request: Mapping[str, Any]) -> Drive:
        with self._maps.for_pricing(costmap_id) as planner:
            points = np.array(request["path"])
            check_points(points)
            planner.read_along(points)
            return Drive.along(planner.lattice, points, battery_of(request["battery"], planner.lattice.robot))

    def _known(self, drive_id: str) -> _Open:
        with self._lock:
            known = self._open.setdefault(drive_id, _Open())
            self._open.move_to_end(drive_id)
            while len(self._open) > 1 and (len(self._open) > _OPEN or self._length_m() > _OPEN_M):
                self._open.popitem(last=False)
        return known

    def _length_m(self) -> float:
        drives = (known.drive for known in self._open.values())
        return sum(drive.tracking.metres.length_m for drive in drives if drive is not None)
