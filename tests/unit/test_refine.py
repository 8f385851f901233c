"""The any-angle step: a straight leg is left where that pays."""

from dataclasses import replace

import numpy as np

from joulemap.planner.edges import path_price
from joulemap.planner.refine import refine_path
from tests.reference.lattices import ascii_lattice


def test_a_straight_leg_bends_towards_cheaper_ground():
    lattice = ascii_lattice("\n".join(["." * 40] * 21))[0]
    cheaper = 1.0 - 0.5 * np.exp(-0.5 * ((np.arange(21.0) - 13.0) / 2.0) ** 2)
    traction = np.broadcast_to(10.0 * cheaper[:, None, None], lattice.traction_per_m.shape).astype(np.float32)
    lattice = replace(lattice, traction_per_m=traction)
    straight = np.array([(10.0, 2.0), (10.0, 37.0)])
    refined = refine_path(lattice, straight)
    np.testing.assert_array_equal(refined[[0, -1]], straight)
    assert path_price(lattice, refined) < 0.95 * path_price(lattice, straight)
