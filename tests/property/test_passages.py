"""Passages between half-cell points: the cheapest path is that of networkx, and it is found where no move leads."""

import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import JoulemapError
from joulemap.planner import corridors
from joulemap.planner.edges import leg_prices_between, path_price
from joulemap.planner.moves import move_table
from joulemap.planner.passages import AROUND, path_through_passages
from joulemap.planner.plan import RoutePlanner
from tests.reference.lattices import random_lattice

ROWS, COLS = 6, 7


def half_cell_graph(lattice, table):
    """Every point and leg that may take part where all cells are near, priced one by one."""
    graph = nx.DiGraph()
    closed = [
        (i, j)
        for i in range(ROWS)
        for j in range(COLS)
        for n, (down, right) in enumerate(table.offsets)
        if 0 <= i + down < ROWS and 0 <= j + right < COLS and math.isnan(table.energy[i, j, n])
    ]
    fine = {(i, j) for i, j in np.ndindex(ROWS, COLS) if any(max(abs(i - a), abs(j - b)) <= AROUND for a, b in closed)}
    points = [
        p for p in np.ndindex(2 * ROWS - 1, 2 * COLS - 1) if p[0] % 2 == p[1] % 2 == 0 or (p[0] // 2, p[1] // 2) in fine
    ]
    known = set(points)
    for i, j in points:
        centre = i % 2 == j % 2 == 0
        for down, right in table.offsets:
            for size in (1, 2) if centre else (1,):
                other = i + size * down, j + size * right
                if other not in known or (size == 1 and (i // 2, j // 2) not in fine):
                    continue
                price = leg_prices_between(lattice, np.array([[i, j]]) / 2, np.array([other]) / 2)[0]
                if math.isfinite(price):
                    graph.add_edge((i, j), other, energy_j=float(price))
    return graph if closed else None


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), limit=st.sampled_from([8.0, 12.0, 20.0]))
def test_the_path_is_the_cheapest_between_half_cell_points(seed, limit):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, ROWS, COLS, max_grade_deg=limit, max_cross_slope_deg=limit)
    start, goal = rng.integers(0, [ROWS, COLS]), rng.integers(0, [ROWS, COLS])
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    table = move_table(lattice, neighbours=32)
    seeds, targets = ((np.array([int(p @ [COLS, 1])]), np.zeros(1)) for p in (start, goal))
    found = path_through_passages(lattice, table, np.arange(ROWS * COLS), seeds, targets)
    graph = half_cell_graph(lattice, table)
    ends = [tuple(int(2 * p) for p in end) for end in (start, goal)]
    if graph is None:
        assert found is None
    elif found is None:
        assert not (ends[0] in graph and ends[1] in graph and nx.has_path(graph, *ends))
    else:
        expected = 0.0 if ends[0] == ends[1] else nx.dijkstra_path_length(graph, *ends, weight="energy_j")
        assert path_price(lattice, found) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_route_is_no_dearer_than_without_passages(monkeypatch):
    """Over ground whose limits close many moves: clearly cheaper somewhere, and dearer by no more than what settling
    from another path may leave."""
    rng = np.random.default_rng(3)
    ratios = []
    for seed in range(40):
        lattice = random_lattice(np.random.default_rng(seed), 30, 30, max_grade_deg=9.0, max_cross_slope_deg=9.0)
        planner = RoutePlanner(lattice)
        free = np.argwhere(lattice.blocked == 0)
        ends = [tuple(float(v) for v in lattice.frame.xy(*end)) for end in free[rng.integers(len(free), size=2)]]
        try:
            now = planner.plan(*ends).route.energy_j
        except JoulemapError:
            continue
        with monkeypatch.context() as patched:
            patched.setattr(corridors, "path_through_passages", lambda *_: None)
            before = planner.plan(*ends).route.energy_j
        ratios.append(now / before)
    assert max(ratios) <= 1.0 + 1e-4
    assert min(ratios) < 0.99
