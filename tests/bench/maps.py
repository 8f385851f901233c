"""The bench's map and robot, and where its questions begin and end."""

from __future__ import annotations

import numpy as np

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.synthesis import TerrainRecipe, make_terrain
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.build import build_lattice

ROBOT = Robot()
CORNERS = ((0.9, 0.1), (0.1, 0.9))
"""Start and goal of the long question, as shares of rows and columns."""


def terrain(cells: int, resolution_m: float) -> Heightmap:
    """Hills of up to 20 degrees, `cells` metres wide."""
    side = round(cells / resolution_m)
    frame = GridFrame(0.0, float(cells), resolution_m, side, side)
    recipe = TerrainRecipe(max_slope_deg=20.0, relief_longest_m=cells / 4, relief_shortest_m=cells / 40)
    return make_terrain(recipe, frame, np.random.default_rng(5))


def physics_lattice(heightmap: Heightmap) -> CostLattice:
    """Its cost lattice by the paper's equation 5: 1 m cells, 16 headings."""
    return build_lattice(heightmap, ROBOT, load_predictor("physics"))


def free_corner(lattice: CostLattice, near: tuple[float, float]) -> np.ndarray:
    """The free cell nearest to a point given as shares of rows and columns."""
    free = np.argwhere(lattice.blocked == 0)
    target = np.array(near) * lattice.frame.shape
    return free[np.argmin(((free - target) ** 2).sum(axis=1))].astype(float)
