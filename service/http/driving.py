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

from joulemap.model.errors import ConflictError
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.http.job_events import JobState, Look
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.library.drive import Drive
from joulemap.service.places import Places
from joulemap.service.questions.drive import DriveRequest, UpdateRequest
from joulemap.service.questions.parts import battery_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import RUNNING, DriveRow

_OPEN = 256  # drives whose routes are kept in memory
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
                row = store.drive(drive_id)
                if known.drive is None or known.updates != row.updates:
                    known.drive = known.drive or self._made(row.costmap_id, row.request)
                    known.drive.restore(row.state)
                drive, known.updates = known.drive, -1  # until what follows is kept
                for sample in wanted.samples:
                    drive.update(**{name: getattr(sample, name) for name in type(sample).model_fields})
                state, forecast = drive.as_dict(), drive.forecast().as_dict()
                if store.note_drive(row, state, forecast):
                    known.updates = row.updates = row.updates + 1
                    row.state, row.forecast = state, forecast
                    return row
        raise ConflictError(f"drive {drive_id} is updated by others at the same moment: send the samples again")

    def _made(self, costmap_id: str, request: Mapping[str, Any]) -> Drive:
        with self._maps.for_pricing(costmap_id) as planner:
            points = np.array(request["path"])
            if isinstance(planner, StoredPlanner):
                planner.read_along(points)
            route = price_given_path(planner.lattice, points)
            return Drive(planner.lattice, route, battery_of(request["battery"], planner.lattice.robot))

    def _known(self, drive_id: str) -> _Open:
        with self._lock:
            known = self._open.setdefault(drive_id, _Open())
            self._open.move_to_end(drive_id)
            while len(self._open) > _OPEN:
                self._open.popitem(last=False)
        return known
