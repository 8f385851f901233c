"""What a cost lattice needs of a predictor: the only thing about models that the planner knows."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap


class TractionSource(Protocol):
    """Traction demand [J per horizontal metre] of a place and a heading; `Robot.price_per_m` makes energy of it."""

    @property
    def name(self) -> str: ...

    def provenance(self) -> dict[str, Any]:
        """JSON-able: name, kind, version, config."""

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """In words, with value and limit, every way in which this map or robot lies outside what was learned."""

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """(rows, cols, headings) float32 at the cell centres of `frame`, NaN where the map is unknown: traction [J/m],
        and the standard deviation of a 1 m segment's energy [J], None from a source that does not know it.
        """
