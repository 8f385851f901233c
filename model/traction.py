"""What a cost lattice needs of a predictor; the planner knows nothing else about models."""

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
    def name(self) -> str:
        """Name of the model."""

    def provenance(self) -> dict[str, Any]:
        """Return name, kind, version and configuration of the model, JSON-able."""

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Return every way in which the map or the robot lies outside what the model was trained on.

        Result: sentences with value and limit; empty where nothing is outside.
        """

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Predict the traction at every cell centre and heading.

        `headings_rad` (headings,): headings of the motion [rad]. Returns `traction` (rows, cols, headings): traction
        demand [J/m], NaN where the map is unknown; `std`: standard deviation of the energy of a 1 m segment [J] in the
        same shape, None from a source without one.
        """
