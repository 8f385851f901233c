"""Room on the disk: new work is refused before it is full, what arrives has room reserved, and deleting is possible."""

from __future__ import annotations

import shutil
from collections import Counter
from contextlib import suppress
from pathlib import Path

from joulemap.model.errors import StorageFullError

_RESERVE_BYTES = 4_000_000  # more than the database writes to delete a row
_STEP_BYTES = 1_000_000  # by which room is reserved for an upload that does not say how long it is


class Room:
    """The disk of a data folder, of which some stays free."""

    def __init__(self, folder: Path, *, least_free_bytes: int) -> None:
        self._folder, self._least = folder, least_free_bytes
        self._reserve = folder / "reserve"
        self.arriving: Counter[str | None] = Counter()
        """Bytes that are reserved for uploads on their way, by owner."""
        self.arrived = 0
        """Bytes of these uploads that are on the disk."""

    def check(self, promised_bytes: int) -> None:
        """Check that there is room for what may still come: of jobs (`promised_bytes`) and of uploads on their way."""
        to_come = promised_bytes + self.arriving.total() - self.arrived
        free = shutil.disk_usage(self._folder).free
        if free - to_come < self._least:
            raise StorageFullError(
                f"the disk is full: {free / 1e6:.0f} MB are free, this and other unfinished work take up to "
                f"{to_come / 1e6:.0f} MB, and {self._least / 1e6:.0f} MB must stay free (JOULEMAP_MIN_FREE_MB): delete "
                "what is not needed any more",
                free_bytes=free,
                to_come_bytes=to_come,
                least_free_bytes=self._least,
            )

    def keep_reserve(self) -> None:
        """Have a file that can be given up on a full disk, once there is room for it."""
        if not self._reserve.exists() and shutil.disk_usage(self._folder).free > self._least + 2 * _RESERVE_BYTES:
            with suppress(OSError):
                self._reserve.write_bytes(bytes(_RESERVE_BYTES))

    def make_a_little(self) -> bool:
        """Give up the reserve. Result: False where that does not help."""
        if shutil.disk_usage(self._folder).free > _RESERVE_BYTES or not self._reserve.exists():
            return False
        self._reserve.unlink(missing_ok=True)
        return True


class Upload:
    """An upload on its way; all uploads of a service are counted on its event loop."""

    def __init__(self, room: Room, owner: str | None) -> None:
        self._room, self._owner = room, owner
        self._reserved = self._arrived = 0

    def reserve(self, more_bytes: int) -> None:
        """Reserve room, before it is checked that there is some: of two uploads at a time one is refused."""
        self._reserved += more_bytes
        self._room.arriving[self._owner] += more_bytes

    def arrives(self, more_bytes: int) -> bool:
        """Count what goes to the disk now. Result: whether more had to be reserved for it, which is to be checked."""
        lacking = self._arrived + more_bytes - self._reserved
        if lacking > 0:
            self.reserve(max(lacking, _STEP_BYTES))
        self._arrived += more_bytes
        self._room.arrived += more_bytes
        return lacking > 0

    def end(self) -> None:
        """Count it no more: it is kept, or removed."""
        self._room.arrived -= self._arrived
        self._room.arriving[self._owner] -= self._reserved
