"""Small lattices whose prices are known in closed form, made without the code under test.

Their robots keep to their paths exactly, so that paths keep no margin and have exact answers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.frames import GridFrame, heading_bins, heading_vector
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import path_price, world_points


def price_world_path(lattice: CostLattice, xy: ArrayLike) -> float:
    """The energy of a polyline of world points with its turns [J]; NaN where a leg may not be driven."""
    return path_price(lattice, world_points(lattice, xy))


def plane_lattice(
    rows: int,
    cols: int,
    rise_east: float = 0.0,
    rise_north: float = 0.0,
    *,
    robot: Robot,
    spacing_m: float = 1.0,
    headings: int = 16,
) -> CostLattice:
    """A tilted plane under the physics model: traction m g (mu + rise along the heading)."""
    frame = GridFrame(0.0, rows * spacing_m, spacing_m, rows, cols)
    x, y = np.meshgrid(*frame.centres())
    return surface_lattice(frame, rise_east * x + rise_north * y, (rise_east, rise_north), robot, headings)


def surface_lattice(frame, elevation, gradient, robot, headings=16) -> CostLattice:
    """Any surface with its exact gradient (two numbers or two arrays): traction m g (mu + gradient . heading)."""
    east, north = heading_vector(heading_bins(headings))
    g_east, g_north = (np.broadcast_to(np.asarray(g, dtype=float), frame.shape) for g in gradient)
    traction = robot.weight_n * (robot.rolling_resistance + g_east[..., None] * east + g_north[..., None] * north)
    return CostLattice(
        frame,
        robot,
        traction.astype(np.float32),
        np.asarray(elevation, dtype=np.float32),
        np.stack([g_east, g_north], axis=-1).astype(np.float32),
        np.zeros(frame.shape, dtype=np.uint8),
    )


def uniform_lattice(rows: int, cols: int, price_per_m, *, headings: int = 16) -> CostLattice:
    """The same directional price F(heading) [J/m] everywhere, on flat ground, with nothing else to pay."""
    frame = GridFrame(0.0, float(rows), 1.0, rows, cols)
    values = np.asarray([price_per_m(h) for h in heading_bins(headings)], dtype=np.float32)
    robot = Robot(idle_power_w=0.0, tracking_std_m=0.0)
    zeros = np.zeros(frame.shape, dtype=np.float32)
    traction = np.broadcast_to(values, (*frame.shape, headings)).copy()
    return CostLattice(frame, robot, traction, zeros, np.zeros((*frame.shape, 2), np.float32), zeros.astype(np.uint8))


def ascii_lattice(drawing: str, *, robot: Robot | None = None) -> tuple[CostLattice, dict[str, tuple[float, float]]]:
    """Flat ground at 1 J/m drawn in ASCII: `.` free, `#` blocked; letters are free and returned as world points."""
    lines = [line.strip() for line in drawing.strip().splitlines()]
    robot = robot or Robot(idle_power_w=0.5, speed_mps=0.5, tracking_std_m=0.0)
    frame = GridFrame(0.0, float(len(lines)), 1.0, len(lines), len(lines[0]))
    blocked = np.array([[Blocked.STEP if c == "#" else Blocked.FREE for c in line] for line in lines], dtype=np.uint8)
    zeros = np.zeros(frame.shape, dtype=np.float32)
    lattice = CostLattice(
        frame, robot, np.zeros((*frame.shape, 8), np.float32), zeros, np.zeros((*frame.shape, 2), np.float32), blocked
    )
    marks = {
        c: tuple(float(v) for v in frame.xy(r, k))
        for r, line in enumerate(lines)
        for k, c in enumerate(line)
        if c.isalpha()
    }
    return lattice, marks


def random_lattice(rng: np.random.Generator, rows: int, cols: int, *, headings: int = 8, **robot) -> CostLattice:
    """A random hilly surface with a rough random loss on top, and some blocked cells."""
    truck = Robot(**({"max_grade_deg": 30.0, "max_cross_slope_deg": 30.0, "tracking_std_m": 0.0} | robot))
    frame = GridFrame(100.0, 200.0, 1.0, rows, cols)
    col, row = np.meshgrid(np.arange(cols), np.arange(rows))
    z, g_east, g_north = np.zeros(frame.shape), np.zeros(frame.shape), np.zeros(frame.shape)
    for _ in range(4):
        k_east, k_north = rng.uniform(-0.5, 0.5, 2)  # waves at least 9 m long
        phase, height = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.1, 0.6)
        z += height * np.sin(k_east * col - k_north * row + phase)
        slope = height * np.cos(k_east * col - k_north * row + phase)
        g_east += k_east * slope
        g_north += k_north * slope
    lattice = surface_lattice(frame, z, (g_east, g_north), truck, headings)
    rough = rng.uniform(0.0, 0.3 * truck.weight_n * truck.rolling_resistance, lattice.traction_per_m.shape)
    blocked = np.where(rng.random(frame.shape) < 0.1, np.uint8(Blocked.STEP), np.uint8(0))
    traction = (lattice.traction_per_m + rough).astype(np.float32)
    return CostLattice(frame, truck, traction, lattice.elevation_m, lattice.gradient, blocked)
