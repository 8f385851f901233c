"""The cheapest path in a tube: as cheap as that of networkx over the same points, priced by the one integrator."""

import itertools
import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import NoRouteError
from joulemap.planner.edges import leg_prices_between, path_price
from joulemap.planner.lattice import Blocked
from joulemap.planner.moves import move_table
from joulemap.planner.search import grid_search
from joulemap.planner.tube import cheapest_in_tube, chords_of
from tests.reference.lattices import random_lattice, uniform_lattice

ROWS, COLS = 5, 6


def least_energy(lattice, start, goal, parts, cells):
    """Least energy [J] by networkx: any straight leg between two points on the border of one square of four cells."""
    graph = nx.DiGraph()
    graph.add_nodes_from(["start", "goal"])
    for i, j in itertools.product(range(ROWS - 1), range(COLS - 1)):
        corners = [(i + a, j + b) for a in (0, 1) for b in (0, 1)]
        border = [(a, b) for a, b in np.ndindex(parts + 1, parts + 1) if a in (0, parts) or b in (0, parts)]
        points = [(parts * i + a, parts * j + b) for a, b in border]
        names = [*points, "start", "goal"]
        places = np.array([*(np.array(points) / parts), start, goal])
        inside = ((places >= (i - 1e-9, j - 1e-9)) & (places <= (i + 1 + 1e-9, j + 1 + 1e-9))).all(axis=1)
        for a, b in itertools.permutations(np.flatnonzero(inside), 2):
            if {names[a], names[b]} == {"start", "goal"}:
                continue
            blend = np.abs(np.array(corners)[None] - places[[a, b]][:, None]).max(axis=2) < 1.0 - 1e-9
            touched = {corner for corner, near in zip(corners, blend.any(axis=0), strict=True) if near}
            price = leg_prices_between(lattice, places[[a]], places[[b]])[0]
            if touched <= cells and math.isfinite(price):
                graph.add_edge(names[a], names[b], energy_j=float(price))
    return nx.dijkstra_path_length(graph, "start", "goal", "energy_j") if nx.has_path(graph, "start", "goal") else None


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), limit=st.sampled_from([8.0, 12.0, 60.0]), parts=st.sampled_from([2, 3]))
def test_it_is_as_cheap_as_by_networkx_over_the_same_points(seed, limit, parts):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, ROWS, COLS, max_grade_deg=limit, max_cross_slope_deg=limit)
    start, goal = rng.uniform(0, [ROWS - 1, COLS - 1]), rng.integers(0, [ROWS, COLS]).astype(float)
    found = cheapest_in_tube(lattice, np.vstack([start, goal]), half_side=max(ROWS, COLS), parts=parts)
    least = least_energy(lattice, start, goal, parts, set(np.ndindex(ROWS, COLS)))
    if least is None:
        assert len(found) == 0
    else:
        assert path_price(lattice, found) == pytest.approx(least, rel=1e-5, abs=1e-6)
        np.testing.assert_array_equal(found[[0, -1]], [start, goal])


def test_cells_outside_the_tube_take_no_part():
    lattice = random_lattice(np.random.default_rng(2), ROWS, COLS, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    lattice.blocked[:] = 0
    line = np.array([(1.0, 0.0), (1.0, COLS - 1.0)])
    found = cheapest_in_tube(lattice, line, half_side=1, parts=3)
    cells = {(i, j) for i in range(3) for j in range(COLS)}
    assert path_price(lattice, found) == pytest.approx(least_energy(lattice, *line, 3, cells), rel=1e-5)
    assert found[:, 0].max() <= 2.0


def test_chords_are_as_many_as_pairs_of_points_on_different_sides():
    for parts in (2, 4):
        chords = chords_of(parts)
        size, border = parts + 1, 4 * parts
        pairs = border * (border - 1) - 4 * size * (size - 1)  # of one square, none along its sides
        assert len(chords.cell) == pairs + 4 * parts  # and both directions of the parts of two of its sides
        assert chords.blend.sum(axis=2) == pytest.approx(np.ones((len(chords.cell), 3)))


def test_it_passes_where_no_move_of_the_grid_does():
    """A wall with a gap that may be driven along a line of centres only, because the cells beside it are blocked."""
    lattice = uniform_lattice(9, 21, lambda heading: 1.0)
    lattice = replace(lattice, robot=replace(lattice.robot, max_cross_slope_deg=0.9, max_grade_deg=40.0))
    lattice.blocked[:, 9:12] = Blocked.STEP
    lattice.blocked[4, 9:12] = Blocked.FREE
    heading = math.radians(98.0)  # at which alone the two cells beside the gap may be driven
    lattice.blocked[5, 12:14] = lattice.blocked[4, 12:14] = Blocked.FREE
    lattice.gradient[4:6, 12:14] = 0.4 * math.sin(heading), 0.4 * math.cos(heading)
    lattice.blocked[[0, 1, 2, 3, 6, 7, 8], 12:14] = Blocked.STEP
    ends = np.array([(4.0, 2.0), (4.0, 18.0)])
    with pytest.raises(NoRouteError):
        grid_search(lattice, move_table(lattice, neighbours=32), *ends)
    found = cheapest_in_tube(lattice, ends, half_side=4)
    assert math.isfinite(path_price(lattice, found))


def test_it_is_cheaper_than_the_grid_on_random_ground():
    lattice = random_lattice(np.random.default_rng(5), 40, 40, max_grade_deg=12.0, max_cross_slope_deg=12.0)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    grid = grid_search(lattice, move_table(lattice, neighbours=32), free[3], free[-3])
    found = cheapest_in_tube(lattice, grid.points, half_side=4, parts=4)
    assert path_price(lattice, found) < 0.99 * grid.energy_j
