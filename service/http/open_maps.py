"""The few cost maps that are kept in memory for questions, which many threads share: planners and latest answers."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from joulemap.model.errors import JoulemapError, NotFoundError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner


class _Entry:
    def __init__(self) -> None:
        self.loading = threading.Lock()
        self.planner: RoutePlanner | None = None
        self.stored: StoredPlanner | None = None
        self.pricer: StoredPlanner | None = None  # for given paths, which are not to wait for a search
        self.searching, self.pricing = threading.Lock(), threading.Lock()


class OpenMaps:
    """Cost maps in memory; above `size` the least recently used one is dropped.

    A planner in memory keeps tables that do not change once they are made, so any number of threads ask it at a time.
    One that leaves its cost map on disk answers one question at a time.
    """

    def __init__(
        self,
        load: Callable[[str], CostLattice],
        *,
        size: int,
        place: Callable[[str], Path],
        status: Callable[[str], str | None],
        most_cells: int,
        memory_bytes: int,
    ) -> None:
        self._load, self._status = load, status
        self._place, self._most_cells, self._memory = place, most_cells, memory_bytes
        self._size = size
        self._lock = threading.Lock()
        self._entries: OrderedDict[str, _Entry] = OrderedDict()
        self.hits = self.misses = 0

    def __len__(self) -> int:
        return len(self._entries)

    def is_open(self, costmap_id: str) -> bool:
        """Return whether a planner of a cost map is in memory, so that its questions may run side by side.

        Result: False too for one that is planned on from disk.
        """
        return self.opened(costmap_id) is not None

    def opened(self, costmap_id: str) -> RoutePlanner | None:
        """Return the planner of a cost map that is in memory, without loading it."""
        entry = self._entries.get(costmap_id)
        return None if entry is None else entry.planner

    def planner(self, costmap_id: str) -> RoutePlanner:
        """Return the planner of a cost map, which other threads may use at the same time."""
        entry = self._entry(costmap_id)
        with entry.loading, self._unless_deleted(costmap_id):
            return self._loaded(entry, costmap_id)

    @contextmanager
    def _unless_deleted(self, costmap_id: str) -> Iterator[None]:
        """Raise NotFoundError where what cannot be read of a cost map was deleted meanwhile: it is not damaged then."""
        try:
            yield
        except (JoulemapError, OSError) as error:
            if self._status(costmap_id) is None:
                raise NotFoundError(f"there is no cost map {costmap_id!r}", costmap_id=costmap_id) from error
            raise

    @contextmanager
    def for_routes(self, costmap_id: str) -> Iterator[RoutePlanner | StoredPlanner]:
        """Lend a planner of a cost map; of a large map, to this thread alone, one that leaves the map on disk."""
        entry = self._entry(costmap_id)
        with entry.loading, self._unless_deleted(costmap_id):
            if entry.planner is None and entry.stored is None:
                stored = StoredPlanner(self._place(costmap_id), memory_bytes=self._memory)
                if stored.stored.cells > self._most_cells:
                    entry.stored = stored
            if entry.stored is None:
                self._loaded(entry, costmap_id)
        if entry.planner is not None:
            yield entry.planner
            return
        assert entry.stored is not None
        with entry.searching, self._unless_deleted(costmap_id):
            yield entry.stored

    @contextmanager
    def for_pricing(self, costmap_id: str) -> Iterator[RoutePlanner | StoredPlanner]:
        """Lend a planner of a cost map to price given paths, which does not wait for searches."""
        entry = self._entry(costmap_id)
        if entry.planner is None:
            with entry.pricing, self._unless_deleted(costmap_id):
                if entry.pricer is None:
                    entry.pricer = StoredPlanner(self._place(costmap_id), memory_bytes=self._memory)
                if entry.pricer.stored.cells > self._most_cells:
                    yield entry.pricer
                    return
        yield self.planner(costmap_id)

    def _loaded(self, entry: _Entry, costmap_id: str) -> RoutePlanner:
        """The planner of an entry whose lock `loading` this thread holds."""
        if entry.planner is None:
            self.misses += 1
            entry.planner = RoutePlanner(self._load(costmap_id))
            entry.pricer = None
        else:
            self.hits += 1
        return entry.planner

    def _entry(self, costmap_id: str) -> _Entry:
        with self._lock:
            entry = self._entries.setdefault(costmap_id, _Entry())
            self._entries.move_to_end(costmap_id)
            self._let_go()
        return entry

    def keep(self, costmap_id: str, planner: RoutePlanner) -> None:
        """Keep a planner that is ready for questions."""
        entry = _Entry()
        entry.planner = planner
        with self._lock:
            self._entries[costmap_id] = entry
            self._let_go()

    def forget(self, costmap_id: str) -> None:
        """Drop a cost map that was deleted."""
        with self._lock:
            self._entries.pop(costmap_id, None)

    def _let_go(self) -> None:
        while len(self._entries) > self._size:
            self._entries.popitem(last=False)


_MOST = 8  # of a cost map


class KeptAnswers:
    """What was found for questions. It goes with the planner of its map, and holds no other lattice in memory."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._of: WeakKeyDictionary[RoutePlanner, OrderedDict[str, Any]] = WeakKeyDictionary()

    def find(self, planner: RoutePlanner, question: str) -> Any:
        """Return what was found for a question; None where it is not known any more."""
        with self._lock:
            kept = self._of.get(planner)
            return None if kept is None else kept.get(question)

    def keep(self, planner: RoutePlanner, question: str, found: Any) -> None:
        """Keep what was found, unless it is of a lattice of its own, as with areas to avoid."""
        lattice = planner.lattice
        with self._lock:
            kept = self._of.setdefault(planner, OrderedDict())
            kept[question] = found
            kept.move_to_end(question)
            for old in [name for name, one in kept.items() if one.lattice is not lattice] + list(kept)[:-_MOST]:
                kept.pop(old, None)
