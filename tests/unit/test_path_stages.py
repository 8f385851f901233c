"""Each stage of the any-angle step alone brings a path back to the straight line, on flat ground at 1 J/m.

There the least energy is the distance, so what each stage must reach is known.
"""

import numpy as np
import pytest

from joulemap.model.robot import Robot
from joulemap.planner.any_angle.bending import ACROSS, ON_LINE, bent
from joulemap.planner.any_angle.shortcuts import shortcuts
from joulemap.planner.pricing.integrator import driven_prices, exact_prices, path_price
from tests.reference.lattices import ascii_lattice

LENGTH = 32.0
COLS = np.linspace(4.0, 4.0 + LENGTH, 9)


def flat(turn_j_per_rad=0.0):
    robot = Robot(idle_power_w=0.5, speed_mps=0.5, turn_j_per_rad=turn_j_per_rad, tracking_std_m=0.0)
    return ascii_lattice("\n".join(["." * 41] * 21), robot=robot)[0]


def test_shortcuts_leave_out_the_vertices_of_a_zigzag():
    lattice = flat()
    zigzag = np.column_stack([np.where(np.arange(9) % 2, 12.0, 10.0), COLS])
    assert path_price(lattice, zigzag) > 1.1 * LENGTH
    np.testing.assert_array_equal(shortcuts(driven_prices(lattice, 1.0), zigzag), zigzag[[0, -1]])


@pytest.mark.parametrize("turn_j_per_rad", [0.0, 2.0])
@pytest.mark.parametrize("direction", [ACROSS, ON_LINE])
def test_bending_takes_a_bulge_back(turn_j_per_rad, direction):
    lattice = flat(turn_j_per_rad)
    bulge = np.column_stack(
        [np.array([10, 10, 10, 10, 11, 10, 10, 10, 10]) + 0.5, COLS]
    )  # on the columns' lines, between two centres
    found = bent(exact_prices(lattice)._replace(turn_j_per_rad=turn_j_per_rad), bulge, 1.0, direction)
    np.testing.assert_array_equal(found[[0, -1]], bulge[[0, -1]])
    assert path_price(lattice, bulge) > 1.003 * LENGTH
    assert path_price(lattice, found) == pytest.approx(LENGTH, rel=1e-9)
