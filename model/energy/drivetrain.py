"""Gears and motors: what a climb asks of the battery beyond the work that is done on the robot."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from joulemap.model.robot import Robot

_Real = TypeVar("_Real", np.float32, np.float64)
SIMULATED = 0.8
"""Efficiency of the gears that the simulated robots of the shipped network have in the mean."""


def changes(robot: Robot, known: float) -> bool:
    """Whether a robot declares another efficiency than the one that a model knows, 0 where that knows none."""
    return robot.drivetrain_efficiency > 0.0 and known > 0.0 and robot.drivetrain_efficiency != known


def geared(traction: NDArray[_Real], robot: Robot, known: float) -> NDArray[_Real]:
    """Return traction with the efficiency that a robot declares in place of that which a model knows.

    Rolling on level ground is declared as the battery sees it, so only what is beyond it passes the drivetrain: climbs
    ask more of the battery, and descents spare it as much more while the drives pull. What is regenerated passes it the
    other way.

    traction : of any shape [J/m], changed in place; known : 0 where the model does not know it, 1 where it leaves the
    drivetrain out. Result: `traction`; as it was where the robot or the model says nothing.
    """
    if changes(robot, known):
        level = traction.dtype.type(robot.weight_n * robot.rolling_resistance)
        ratio = traction.dtype.type(known / robot.drivetrain_efficiency)
        traction -= level
        traction *= ratio
        traction += level
        if robot.regeneration > 0.0:
            np.divide(traction, ratio, out=traction, where=traction < 0.0)
    return traction
