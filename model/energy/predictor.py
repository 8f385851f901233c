"""The protocol by which joulemap asks a model, and how a model is found by name or folder."""

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

    Lattice and single segments give the same answer for the same place and heading, up to float32 rounding.
    """

    @property
    def spread(self) -> Spread:
        """Width of the intervals around its answers."""

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return the traction of `traction_and_std`.

        Parameters
        ----------
        heightmap, robot, frame, headings_rad : Heightmap, Robot, GridFrame, ndarray
            As `traction_and_std`.

        Returns
        -------
        ndarray of float32, (rows, cols, K)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        return self.traction_and_std(heightmap, robot, frame, headings_rad)[0]

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> NDArray[np.float64]:
        """Return the traction demand of 1 m segments.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.
        x, y : array_like, (n,)
            Centres of the segments [m].
        heading_rad : array_like, (n,)
            Headings [rad].

        Returns
        -------
        ndarray of float64, (n,)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        return self.segment_traction_and_std(heightmap, robot, x, y, heading_rad)[0]

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return the traction demand of 1 m segments and its uncertainty.

        Parameters
        ----------
        heightmap, robot, x, y, heading_rad : Heightmap, Robot, array_like
            As `segment_traction`.

        Returns
        -------
        traction : ndarray of float64, (n,)
            Traction demand [J/m]; NaN where the map is unknown.
        std : ndarray of float64, (n,), optional
            Standard deviation of each segment's energy [J]; None where the model does not know it.
        """


def load_predictor(spec: str | Path) -> Predictor:
    """Return the predictor of a model.

    Parameters
    ----------
    spec : str or Path
        "physics", "default" (the shipped network), or the folder of a trained model.

    Returns
    -------
    Predictor
        Ready to be asked.

    Raises
    ------
    ModelError
        If there is no such model (the known names are in the message), or its files do not fit together.
    """
    if spec == "physics":
        return PhysicsPredictor()
    # here, because it builds on this module
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
