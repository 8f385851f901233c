"""Corridors: the best grid path, and those of other ways that are nearly as good."""

import numpy as np

from joulemap.planner.corridors import corridor_paths
from joulemap.planner.moves import move_table
from tests.reference.lattices import ascii_lattice

HIGH, LOW = 2, 6  # rows of two passages, four cells apart
BEGINS, ENDS, COLS = 100, 104, 280


def test_passages_four_cells_apart_are_two_corridors_of_a_path_of_a_quarter_kilometre():
    """Both are short: a path has only little in common with both searches there."""
    rows = [["."] * COLS for _ in range(9)]
    for row in set(range(9)) - {HIGH, LOW}:
        rows[row][BEGINS:ENDS] = "#" * (ENDS - BEGINS)
    lattice = ascii_lattice("\n".join(map("".join, rows)))[0]
    start, goal = np.array([4.0, 5.0]), np.array([4.0, 265.0])
    found, _ = corridor_paths(lattice, move_table(lattice, neighbours=32), start, goal, margin=0.02)
    crossed = {float(row) for path in found for row, col in path.points if BEGINS <= col < ENDS}
    assert crossed == {HIGH, LOW}
