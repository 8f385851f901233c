"""The latest answers over each cost map in memory: a route that was answered is not planned again for its file."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any
from weakref import WeakKeyDictionary

from joulemap.planner.route_planner import RoutePlanner

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
