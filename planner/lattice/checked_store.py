"""A folder of zarr arrays whose checksums are verified by whatever is read from it, through zarr or past it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import zarr
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.storage import LocalStore, WrapperStore

from joulemap.planner.lattice.checksums import Checksums


class CheckedStore(WrapperStore[LocalStore]):
    """A store for reading: what was written comes back, or it is an error. What was never written is not there."""

    def __init__(self, checksums: Checksums) -> None:
        super().__init__(LocalStore(checksums.folder, read_only=True))
        self.checksums = checksums

    @classmethod
    def of(cls, group: zarr.Group) -> CheckedStore:
        """Return the store of a group that was opened with one."""
        store = group.store
        assert isinstance(store, cls)
        return store

    def _with_store(self, store: LocalStore) -> CheckedStore:
        return CheckedStore(self.checksums)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return a file or a part of it, as `zarr.abc.store.Store` describes it.

        Result: None for what was never written.
        """
        if key not in self.checksums:
            return None
        content = await asyncio.to_thread(self.checksums.content, key)
        return prototype.buffer.from_bytes(content[_part(byte_range, len(content))])

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return several files or parts of files."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def exists(self, key: str) -> bool:
        """Return whether a file was written. Result: True for one that was lost, too: reading it says so."""
        return key in self.checksums


def _part(wanted: Any, size: int) -> slice:
    match wanted:
        case RangeByteRequest():
            return slice(wanted.start, wanted.end)
        case OffsetByteRequest():
            return slice(wanted.offset, size)
        case SuffixByteRequest():
            return slice(max(size - wanted.suffix, 0), size)
    return slice(None)
