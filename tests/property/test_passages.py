"""Passages between half-cell points: paths are as cheap as those of networkx, and lead where no move does."""

import math

import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import JoulemapError
from joulemap.planner import corridors
from joulemap.planner.edges import leg_prices_between, path_price
from joulemap.planner.moves import move_table
from joulemap.planner.passages import AROUND, LONGEST_LEG, path_through_passages
from joulemap.planner.plan import RoutePlanner
from tests.reference.lattices import random_lattice

ROWS, COLS = 6, 7


SPAN = range(-LONGEST_LEG, LONGEST_LEG + 1)
LONG_LEGS = [(down, right) for down in SPAN for right in SPAN if math.gcd(down, right) == 1]


def half_cell_graph(lattice, table, *, long):
    """Every point and leg that may take part where all cells are near, priced one by one; `long` legs beside closed
    cells are those of any heading."""
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

    def add(point, other):
        if other in known:
            price = leg_prices_between(lattice, np.array([point]) / 2, np.array([other]) / 2)[0]
            if math.isfinite(price):
                graph.add_edge(point, other, energy_j=float(price))

    for i, j in points:
        centre = i % 2 == j % 2 == 0
        for down, right in table.offsets:
            if centre:
                add((i, j), (i + 2 * down, j + 2 * right))
            if (i // 2, j // 2) in fine:
                add((i, j), (i + down, j + right))
        if long and (i // 2, j // 2) in closed:
            for down, right in LONG_LEGS:
                add((i, j), (i + down, j + right))
    return graph if closed else None


def random_task(seed, limit):
    """A lattice whose limits close many moves, its moves, and two cells."""
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, ROWS, COLS, max_grade_deg=limit, max_cross_slope_deg=limit)
    start, goal = rng.integers(0, [ROWS, COLS]), rng.integers(0, [ROWS, COLS])
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    return lattice, move_table(lattice, neighbours=32), start, goal


def found_path(lattice, table, start, goal):
    seeds, targets = ((np.array([int(p @ [COLS, 1])]), np.zeros(1)) for p in (start, goal))
    return path_through_passages(lattice, table, np.arange(ROWS * COLS), seeds, targets)


def least_energy(graph, start, goal):
    """Least energy [J] by networkx; infinite where there is no way."""
    ends = [tuple(int(2 * p) for p in end) for end in (start, goal)]
    if ends[0] == ends[1]:
        return 0.0
    if graph is None or not (ends[0] in graph and ends[1] in graph and nx.has_path(graph, *ends)):
        return math.inf
    return nx.dijkstra_path_length(graph, *ends, weight="energy_j")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), limit=st.sampled_from([8.0, 12.0, 20.0]))
def test_the_path_is_at_least_as_cheap_as_by_short_legs_and_no_cheaper_than_by_all(seed, limit):
    lattice, table, start, goal = random_task(seed, limit)
    found = found_path(lattice, table, start, goal)
    graphs = [half_cell_graph(lattice, table, long=long) for long in (True, False)]
    least, most = (least_energy(graph, start, goal) for graph in graphs)
    if graphs[0] is None:
        assert found is None
    elif found is None:
        assert math.isinf(most)
    else:
        price = path_price(lattice, found)
        assert least - 1e-6 * (1.0 + abs(least)) <= price <= most + 1e-6 * (1.0 + abs(most))


def test_a_passage_is_found_that_is_open_between_two_short_headings_only():
    cheaper = 0
    for seed in range(60):
        lattice, table, start, goal = random_task(seed, 9.0)
        found = found_path(lattice, table, start, goal)
        if found is not None:
            most = least_energy(half_cell_graph(lattice, table, long=False), start, goal)
            cheaper += path_price(lattice, found) < most - 0.02 * abs(most)
    assert cheaper > 0


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
