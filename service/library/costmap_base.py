"""What everything that is asked of a cost map starts from: its lattice, its planner, what it was made for."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from joulemap.model.robot import Robot
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.places.coordinates import PlaceLike

Point = PlaceLike
"""World x, y [m] in the CRS of the map; or latitude, longitude, see `service.places.coordinates.world_point`."""


class CostMapBase:
    """A cost map without questions.

    Parameters
    ----------
    lattice : CostLattice
        The prices, limits and heights.
    """

    def __init__(self, lattice: CostLattice) -> None:
        self.lattice = lattice

    def __getstate__(self) -> dict[str, Any]:
        """Leave the planner out of copies: it has locks, and is made again when it is needed."""
        return {name: value for name, value in self.__dict__.items() if name != "planner"}

    @property
    def _whole(self) -> CostLattice:
        """The lattice, for what needs all cells."""
        return self.lattice

    @property
    def robot(self) -> Robot:
        """The robot that the map is made for, with what its model found its turns to cost."""
        return self.lattice.robot

    @property
    def crs(self) -> str | None:
        """Coordinate system of the map, None where the heightmap did not name one."""
        return self.lattice.frame.crs

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north [m]."""
        return self.lattice.frame.bounds

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return list(self.lattice.provenance.get("warnings", []))

    @cached_property
    def planner(self) -> RoutePlanner:
        """The planner of this map. It keeps what repeated questions share."""
        return RoutePlanner(self.lattice)
