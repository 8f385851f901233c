"""The drives that are followed now: each is kept in the database at every update, and its route here.

So any service over the same database takes the next update, and a killed one has lost nothing that it acknowledged.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from sqlalchemy import select

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.driving.ahead import check_points
from joulemap.service.http.job_events import JobState, Look
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.library.drive import Drive
from joulemap.service.places import Places
from joulemap.service.questions.drive import DriveRequest, UpdateRequest
from joulemap.service.questions.parts import battery_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import RUNNING, DriveRow

_OPEN, _OPEN_M = 256, 200_000.0  # drives whose routes are kept in memory, and the length of these together [m]
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
        return store.add_drive(costmap_id, request, drive.as_dict(), drive.forecast().as_dict())

    def update(self, store: Store, drive_id: str, wanted: UpdateRequest) -> DriveRow:
        """Take in samples, and return the drive with its new forecast once both are kept."""
        known = self._known(drive_id)
        with known.lock:
            for _ in range(_TRIES):
                row = self._row(store, drive_id)
                if known.drive is None or known.updates != row.updates:
                    known.drive = known.drive or self._made(row.costmap_id, row.request)
                    known.drive.restore(row.state)
                drive, known.updates = known.drive, -1  # until what follows is kept
                drive.take({name: getattr(one, name) for name in type(one).model_fields} for one in wanted.samples)
                state, forecast = drive.as_dict(), drive.forecast().as_dict()
                if store.note_drive(row, state, forecast, drive.tracking.unused):
                    known.updates = row.updates = row.updates + 1
                    row.state, row.forecast, row.unused = state, forecast, drive.tracking.unused
                    return row
        raise ConflictError(f"drive {drive_id} is updated by others at the same moment: send the samples again")

    def forget(self, drive_id: str) -> None:
        """Keep nothing of a drive in memory: it was deleted."""
        with self._lock:
            self._open.pop(drive_id, None)

    def _row(self, store: Store, drive_id: str) -> DriveRow:
        try:
            return store.drive(drive_id)
        except NotFoundError:
            self.forget(drive_id)
            raise

    def _made(self, costmap_id: str, request: Mapping[str, Any]) -> Drive:
        with self._maps.for_pricing(costmap_id) as planner:
            points = np.array(request["path"])
            check_points(points)
            if isinstance(planner, StoredPlanner):
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
