"""What a model is to the rest of joulemap, and how one is found by name or folder."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.traction import TractionSource

MODEL_NAMES = ("physics", "default")
"""Models known by name; anything else is a trained model's folder."""

SHIPPED_WEIGHTS = resources.files("joulemap.model") / "weights"
"""The folder of the shipped network."""


class Predictor(TractionSource, Protocol):
    """A traction source that also answers for single segments.

    Both ways to ask answer the same for the same place and heading, to float32 rounding.
    """

    @property
    def spread(self) -> Spread:
        """How wide the intervals of its answers are."""

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """The traction of `traction_and_std` alone."""

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> NDArray[np.float64]:
        """(n,) [J/m] of 1 m segments centred at (x, y) [m]; NaN where the map is unknown."""

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """`segment_traction`, and the standard deviation of each segment's energy [J] where the model knows it."""


def load_predictor(spec: str | Path) -> Predictor:
    """The predictor called "physics" or "default" (the shipped network), or the one in a trained model's folder.

    Raises ModelError, with the known names, when there is no such model or its files do not fit together.
    """
    if spec == "physics":
        return PhysicsPredictor()
    # torch is slow to import, and physics must answer without it
    from joulemap.model.energy.artifact import load_artifact

    if spec == "default":
        with resources.as_file(SHIPPED_WEIGHTS) as folder:
            return load_artifact(folder, name="default")
    folder = Path(spec)
    if not folder.is_dir():
        raise ModelError(
            f"there is no model {str(spec)!r}: known are {', '.join(MODEL_NAMES)}, or the folder of a trained model",
            model=str(spec),
            known=list(MODEL_NAMES),
        )
    return load_artifact(folder)
