"""A slow check of the robot's outline: every pose of a route, the rectangle on a raster of one centimetre."""

import math

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

ROBOTS = (
    (Robot(width_m=0.3, length_m=0.3, wheel_radius_m=0.05), 0.05, 0.1),
    (Robot(), 0.05, 0.2),
    (Robot(width_m=0.6, length_m=0.9, clearance_m=0.15, centre_ahead_m=0.2), 0.1, 0.2),
    (Robot(width_m=1.2, length_m=2.4, wheel_radius_m=0.3, centre_ahead_m=0.6), 0.2, 0.4),
    (Robot(width_m=2.0, length_m=4.0, wheel_radius_m=0.5), 0.5, 0.5),
)
"""Robots, with the cells of their survey and the spacing of their lattice [m]."""


def collides(wall: NDArray[np.bool_], frame: GridFrame, robot: Robot, x: float, y: float, heading: float) -> bool:
    """Whether a centimetre of the outline and its clearance is on a wall, or off the map."""
    half, side = 0.5 * robot.length_m + robot.clearance_m, 0.5 * robot.width_m + robot.clearance_m
    ahead, right = np.meshgrid(
        robot.centre_ahead_m + np.arange(-half + 0.005, half, 0.01), np.arange(-side + 0.005, side, 0.01)
    )
    east, north = math.sin(heading), math.cos(heading)
    row, col = frame.rowcol(x + ahead * east + right * north, y + ahead * north - right * east)
    row, col = np.rint(row).astype(int), np.rint(col).astype(int)
    on = (row >= 0) & (row < frame.rows) & (col >= 0) & (col < frame.cols)
    return bool(not on.all() or wall[row, col].any())


def first_collision(
    points: NDArray[np.float64], robot: Robot, wall: NDArray[np.bool_], frame: GridFrame
) -> tuple[float, float, float] | None:
    """The first pose (x, y, heading) along the legs of a route that meets a wall; poses are half a pixel apart."""
    for begin, end in zip(points[:-1], points[1:], strict=True):
        step = end - begin
        length = float(np.hypot(*step))
        if length < 1e-9:
            continue
        heading = math.atan2(step[0], step[1])
        for share in np.linspace(0.0, 1.0, max(2, math.ceil(2.0 * length / frame.resolution_m))):
            x, y = begin + share * step
            if collides(wall, frame, robot, x, y, heading):
                return float(x), float(y), heading
    return None


def world_with_walls(
    rng: np.random.Generator, robot: Robot, *, cells_m: float, spacing_m: float
) -> tuple[NDArray[np.bool_], Heightmap]:
    """Gentle hills with six walls at any angle, each with a gap, and 15 boulders; as large as 30 widths of a robot."""
    scale = max(robot.width_m + 2.0 * robot.clearance_m, 0.3)
    side = round(30.0 * scale / spacing_m) * spacing_m
    n = round(side / cells_m)
    frame = GridFrame(0.0, side, cells_m, n, n)
    x, y = np.meshgrid(*frame.centres())
    wall = np.zeros((n, n), dtype=np.bool_)
    for _ in range(6):
        angle, (cx, cy) = rng.uniform(0.0, math.pi), rng.uniform(0.2 * side, 0.8 * side, 2)
        u = (x - cx) * math.cos(angle) + (y - cy) * math.sin(angle)
        v = (y - cy) * math.cos(angle) - (x - cx) * math.sin(angle)
        gap, at = rng.uniform(0.8, 2.5) * scale, rng.uniform(-0.2, 0.2) * side
        long = rng.uniform(0.2, 0.5) * side
        wall |= (np.abs(u) < max(0.1 * scale, cells_m)) & (np.abs(v) < long) & (np.abs(v - at) > gap / 2)
    for _ in range(15):
        cx, cy = rng.uniform(0.0, side, 2)
        wall |= np.hypot(x - cx, y - cy) < max(rng.uniform(0.1, 0.5) * scale, cells_m)
    hills = 0.02 * x + 0.2 * np.sin(5.0 * x / side) * np.cos(4.0 * y / side)
    return wall, Heightmap((hills + np.where(wall, scale, 0.0)).astype(np.float32), frame)


def wall_with_door(
    width_m: float, angle_deg: float, *, cells_m: float, side_m: float = 8.0, thick_m: float = 0.2
) -> Heightmap:
    """A wall of 1 m through the middle of level ground, with a door in its middle; at 0 deg it leads to the north."""
    n = round(side_m / cells_m)
    frame = GridFrame(0.0, side_m, cells_m, n, n)
    x, y = (values - side_m / 2 for values in np.meshgrid(*frame.centres()))
    angle = math.radians(angle_deg)
    across, along = x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)
    wall = (np.abs(across) < thick_m / 2) & (np.abs(along) > width_m / 2)
    return Heightmap(np.where(wall, 1.0, 0.0).astype(np.float32), frame)
