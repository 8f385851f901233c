"""MovingAI grid benchmarks (Sturtevant 2012): published optimal lengths, 8-connected, no corner cutting."""

import time
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.moves import move_table

MAPS = ("arena2", "random512-10-1", "London_1_512", "maze512-1-0")
SAMPLE = 80


def read_map(path: Path) -> CostLattice:
    """Passable cells at 1 J/m on flat ground."""
    lines = path.read_text().splitlines()
    grid = np.array([list(line) for line in lines[lines.index("map") + 1 :] if line])
    frame = GridFrame(0.0, float(grid.shape[0]), 1.0, *grid.shape)
    blocked = np.where(np.isin(grid, [".", "G", "S"]), Blocked.FREE, Blocked.STEP).astype(np.uint8)
    zeros = np.zeros(frame.shape, np.float32)
    flat = Robot(idle_power_w=0.5, speed_mps=0.5)
    return CostLattice(
        frame, flat, np.zeros((*frame.shape, 8), np.float32), zeros, np.zeros((*frame.shape, 2), np.float32), blocked
    )


def read_scenarios(path: Path) -> np.ndarray:
    """(n, 5) start x, start y, goal x, goal y, optimal length."""
    rows = [line.split() for line in path.read_text().splitlines()[1:] if line.strip()]
    return np.array([[float(v) for v in row[-5:]] for row in rows])


def check(real_data: Path, name: str, scenarios: slice) -> None:
    lattice = read_map(real_data / "movingai" / f"{name}.map")
    table = move_table(lattice, neighbours=8)
    cases = read_scenarios(real_data / "movingai" / f"{name}.map.scen")[scenarios]
    began = time.perf_counter()
    for sx, sy, gx, gy, optimal in cases:
        found = grid_search(lattice, table, np.array([sy, sx]), np.array([gy, gx]))
        assert found.energy_j == pytest.approx(optimal, abs=1e-4 * max(1.0, optimal)), (sx, sy, gx, gy)
    print(f"{name}: {len(cases)} scenarios, {1e3 * (time.perf_counter() - began) / len(cases):.2f} ms each")


@pytest.mark.parametrize("name", MAPS)
def test_published_optima_on_a_spread_of_scenarios(real_data, name):
    count = len(read_scenarios(real_data / "movingai" / f"{name}.map.scen"))
    check(real_data, name, slice(None, None, max(1, count // SAMPLE)))


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPS)
def test_every_published_optimum(real_data, name):
    check(real_data, name, slice(None))
