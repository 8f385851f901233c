"""The few cost maps that are kept in memory for questions, each with its route planner and a lock."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from joulemap.planner.lattice import CostLattice
from joulemap.planner.plan import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner


class _Entry:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.planner: RoutePlanner | None = None
        self.stored: StoredPlanner | None = None


class OpenMaps:
    """Cost maps in memory; above `size` the least recently used one is dropped.

    Questions to one map are answered one after another.

    Parameters
    ----------
    load : callable
        Returns the lattice of a cost map's id.
    size : int
        Most maps in memory.
    place : callable
        Returns the folder of a cost map's id.
    most_cells : int
        Above so many cells, questions for routes are answered from the folder.
    memory_bytes : int
        Most memory of such a question.
    """

    def __init__(
        self,
        load: Callable[[str], CostLattice],
        *,
        size: int,
        place: Callable[[str], Path],
        most_cells: int,
        memory_bytes: int,
    ) -> None:
        self._load = load
        self._place, self._most_cells, self._memory = place, most_cells, memory_bytes
        self._size = size
        self._lock = threading.Lock()
        self._entries: OrderedDict[str, _Entry] = OrderedDict()

    @contextmanager
    def use(self, costmap_id: str) -> Iterator[RoutePlanner]:
        """Lend the planner of a cost map to this thread alone.

        Parameters
        ----------
        costmap_id : str
            Id of a cost map that is done.

        Yields
        ------
        RoutePlanner
            Loaded where it was not in memory.
        """
        entry = self._entry(costmap_id)
        with entry.lock:
            if entry.planner is None:
                entry.planner = RoutePlanner(self._load(costmap_id))
            yield entry.planner

    @contextmanager
    def use_for_routes(self, costmap_id: str) -> Iterator[RoutePlanner | StoredPlanner]:
        """Lend a planner of a cost map to this thread alone; of a large map, one that leaves it on disk.

        Parameters
        ----------
        costmap_id : str
            Id of a cost map that is done.

        Yields
        ------
        RoutePlanner or StoredPlanner
            For routes and verdicts.
        """
        entry = self._entry(costmap_id)
        with entry.lock:
            if entry.planner is None and entry.stored is None:
                stored = StoredPlanner(self._place(costmap_id), memory_bytes=self._memory)
                if stored.stored.cells > self._most_cells:
                    entry.stored = stored
                else:
                    entry.planner = RoutePlanner(self._load(costmap_id))
            planner = entry.planner or entry.stored
            assert planner is not None
            yield planner

    def _entry(self, costmap_id: str) -> _Entry:
        with self._lock:
            entry = self._entries.setdefault(costmap_id, _Entry())
            self._entries.move_to_end(costmap_id)
            self._let_go()
        return entry

    def keep(self, costmap_id: str, planner: RoutePlanner) -> None:
        """Keep a planner that is ready for questions.

        Parameters
        ----------
        costmap_id : str
            Id of its cost map.
        planner : RoutePlanner
            Ready.
        """
        entry = _Entry()
        entry.planner = planner
        with self._lock:
            self._entries[costmap_id] = entry
            self._let_go()

    def forget(self, costmap_id: str) -> None:
        """Drop a cost map that was deleted.

        Parameters
        ----------
        costmap_id : str
            Its id.
        """
        with self._lock:
            self._entries.pop(costmap_id, None)

    def _let_go(self) -> None:
        while len(self._entries) > self._size:
            self._entries.popitem(last=False)
