"""Heightmaps and robots as Python users give them: a file, an array, a mapping, or the object itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import read_heightmap

GroundLike = Heightmap | str | Path
"""A heightmap, or the path of its file."""
RobotLike = Robot | Mapping[str, Any] | str | Path | None
"""A robot, its fields, the path of its TOML file, or None for the built-in one."""


def heightmap(
    heights: ArrayLike,
    *,
    resolution_m: float,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
) -> Heightmap:
    """Make a heightmap of an array.

    Parameters
    ----------
    heights : array_like, (rows, cols) [m]
        Row 0 is north, column 0 is west. NaN where the height is unknown.
    resolution_m : float
        Side of a cell [m].
    west_m : float, optional
        x of the outer western edge [m].
    north_m : float, optional
        y of the outer northern edge [m]. By default the southern edge is at y = 0.
    crs : str, optional
        Coordinate system in metres, "EPSG:n" or WKT.

    Returns
    -------
    Heightmap
        The heights as float32.

    Raises
    ------
    HeightmapError
        If the array is not two-dimensional and numeric, or no height is known.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> jm.heightmap(np.zeros((40, 60)), resolution_m=0.5).frame.bounds
    (0.0, 0.0, 30.0, 20.0)
    """
    try:
        array = np.asarray(heights, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise HeightmapError(f"the heights are no array of numbers: {error}") from error
    if array.ndim != 2:
        raise HeightmapError(
            f"heights have two dimensions, rows and columns; got {array.ndim}", shape=list(array.shape)
        )
    rows, cols = array.shape
    north = rows * resolution_m if north_m is None else north_m
    return Heightmap(array, GridFrame(west_m, north, resolution_m, rows, cols, crs), source="array")


def ground_of(ground: GroundLike) -> Heightmap:
    """Return the heightmap that is meant.

    Parameters
    ----------
    ground : Heightmap, str or Path
        A heightmap, or the path of a file that says its cell size.

    Returns
    -------
    Heightmap
        Read where it was a path.

    Raises
    ------
    HeightmapError
        If a file cannot be read.
    """
    return ground if isinstance(ground, Heightmap) else read_heightmap(ground)


def robot_of(robot: RobotLike) -> Robot:
    """Return the robot that is meant.

    Parameters
    ----------
    robot : Robot, mapping, str, Path or None
        A robot, its fields, the path of its TOML file, or None for the built-in 35 kg rover.

    Returns
    -------
    Robot
        Checked.

    Raises
    ------
    RobotError
        On an unknown or impossible field.
    """
    if robot is None:
        return Robot()
    if isinstance(robot, Robot):
        return robot
    return Robot.from_mapping(robot) if isinstance(robot, Mapping) else Robot.from_toml(robot)
