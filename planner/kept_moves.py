"""The moves of one lattice, priced once and kept for all questions to it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from joulemap.planner.lattice import CostLattice
from joulemap.planner.places import end_point
from joulemap.planner.pricing.integrator import Points, margin_cells
from joulemap.planner.pricing.moves import MoveTable, distance_table, move_table, with_margin

if TYPE_CHECKING:
    from joulemap.planner.lattice.stored_lattice import StoredLattice

Made = TypeVar("Made")


def distance_lattice(lattice: CostLattice) -> CostLattice:
    """Return the same ground and limits at a price of 1 J/m in every direction: its cheapest path is the shortest.

    `lattice`: prices and limits. Result: the lattice of distances.
    """
    robot = replace(lattice.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
    known = np.einsum("ijk->ij", lattice.traction_per_m)  # NaN where one heading is
    flat = np.empty((*lattice.frame.shape, 4), np.float32)
    flat[...] = np.where(np.isnan(known), np.nan, 0.0)[:, :, None]
    return replace(lattice, robot=robot, traction_per_m=flat, std_j=None)


class KeptMoves:
    """The moves of a lattice, and where a question begins and ends on it.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    """

    def __init__(self, lattice: CostLattice) -> None:
        self.lattice = lattice
        self._distances = distance_lattice(lattice)
        self._made: dict[Any, Any] = {}
        self._making = threading.RLock()  # what is kept is made once; questions then share it without a lock

    @property
    def ground(self) -> CostLattice | StoredLattice:
        """The whole lattice, of which windows may be read: `CostLattice` where it is in memory."""
        return self.lattice

    def needs_memory(self, what: str) -> None:
        """Raise InputError where the lattice is not in memory.

        Parameters
        ----------
        what : str
            What was asked for.
        """

    def read_along(self, xy: ArrayLike) -> None:
        """Read what a polyline needs to be priced on `lattice`, where that is not in memory.

        Parameters
        ----------
        xy : array_like, (n, 2)
            World x, y [m].
        """

    def _priced(self, neighbours: int) -> MoveTable:
        return move_table(self.lattice, neighbours=neighbours)

    def _once(self, name: object, make: Callable[[], Made]) -> Made:
        """What is kept under a name, made now where it is not there yet."""
        if name not in self._made:
            with self._making:
                if name not in self._made:
                    self._made[name] = make()
        return cast("Made", self._made[name])

    def _table(self, neighbours: int, *, distance: bool) -> MoveTable:
        table = self._once(neighbours, lambda: self._priced(neighbours))
        return distance_table(table) if distance else table

    def _with_margin(self, neighbours: int, *, distance: bool) -> MoveTable:
        """The moves of refined routes, which keep the robot's margin to closed ground where another way exists."""

        def _marked() -> MoveTable:
            return with_margin(self._table(neighbours, distance=False), margin_cells(self.lattice))

        table = self._once(("margin", neighbours), _marked)
        return distance_table(table) if distance else table

    def _end(self, name: str, xy: tuple[float, float], notes: list[str], snap: bool) -> Points:
        """Where a route begins or ends for a world point; a note where that is another place."""
        point, note = end_point(self.lattice, float(xy[0]), float(xy[1]), name=name, snap=snap)
        if note is not None:
            notes.append(note)
        return point
