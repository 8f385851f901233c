"""Passages between points within cells: paths are as cheap as those of networkx, and lead where no move does."""

import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import JoulemapError
from joulemap.planner import corridors, passages
from joulemap.planner.best import best_path
from joulemap.planner.edges import leg_prices_between, path_price
from joulemap.planner.heuristics import guide_everywhere
from joulemap.planner.lattice import Blocked
from joulemap.planner.move_prices import leg_stencils, move_offsets
from joulemap.planner.moves import move_table
from joulemap.planner.passage_search import LONGEST_LEG, PER_CELL, SHORT_LEGS
from joulemap.planner.passages import AROUND, paths_through_passages
from joulemap.planner.plan import RoutePlanner
from joulemap.planner.states import new_search, run_search
from tests.reference.lattices import random_lattice, uniform_lattice

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


def found_paths(lattice, table, start, goal):
    """What is found, and the energy of the best path over moves between centres."""
    seeds, targets = ((np.array([int(p @ [COLS, 1])]), np.zeros(1)) for p in (start, goal))
    ahead = new_search(table, 1, seeds[0], np.zeros((1, 1)), backward=False)
    run_search(ahead, table, seeds[0], guide_everywhere(table, backward=False))
    found = paths_through_passages(lattice, table, ahead, np.arange(ROWS * COLS), seeds, targets)
    return found, float(ahead.energy_j[targets[0][0]])


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
    found, over_moves = found_paths(lattice, table, start, goal)
    graphs = [half_cell_graph(lattice, table, long=long) for long in (True, False)]
    least, most = (least_energy(graph, start, goal) for graph in graphs)
    if graphs[0] is None:
        assert found == []
    elif not found:
        assert over_moves <= most + 1e-6 * (1.0 + abs(most))
    else:
        price = path_price(lattice, found[0])
        assert price < over_moves * (1.0 + 1e-6)
        least = least if len(found) == 2 else -math.inf  # the only one has points at a quarter of the spacing
        assert least - 1e-6 * (1.0 + abs(least)) <= price <= most + 1e-6 * (1.0 + abs(most))


def quarter_cell_energy(lattice, start, goal):
    """Least energy over every short leg between points at a quarter of a cell [J], by networkx."""
    size = np.array([PER_CELL * (ROWS - 1) + 1, PER_CELL * (COLS - 1) + 1])
    points = np.array(list(np.ndindex(*size)))
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(points)))
    for step in move_offsets(SHORT_LEGS):
        ends = points + step
        there = ((ends >= 0) & (ends < size)).all(axis=1)
        prices = leg_prices_between(lattice, points[there] / PER_CELL, ends[there] / PER_CELL)
        numbers = np.flatnonzero(there), ends[there] @ [size[1], 1]
        graph.add_weighted_edges_from(
            (a, b, price)
            for a, b, price in zip(*(n.tolist() for n in numbers), prices.tolist(), strict=True)
            if price >= 0
        )
    first, last = (int(PER_CELL * end @ [size[1], 1]) for end in (start, goal))
    return nx.dijkstra_path_length(graph, first, last) if nx.has_path(graph, first, last) else math.inf


def test_the_path_between_quarters_is_no_dearer_than_that_between_halves_or_any_by_short_legs(monkeypatch):
    monkeypatch.setattr(passages, "BESIDE", max(ROWS, COLS))
    compared, cheaper = 0, 0
    for seed in range(25):
        lattice, table, start, goal = random_task(seed, 9.0)
        found, _ = found_paths(lattice, table, start, goal)
        if len(found) < 2 or (start == goal).all():
            continue
        halves, quarters = (path_price(lattice, path) for path in found)
        assert quarters <= halves + 1e-6 * (1.0 + halves)
        cheaper += quarters < 0.99 * halves
        if np.isnan(table.energy).any(axis=2).all():  # all points take part
            compared += 1
            assert quarters <= quarter_cell_energy(lattice, start, goal) * (1.0 + 1e-6)
    assert compared > 3
    assert cheaper > 1


def test_what_a_leg_touches_gives_its_mean_traction():
    """On ground where the traction is positive everywhere, the price of a leg is linear in that of its cells."""
    rng = np.random.default_rng(4)
    lattice = random_lattice(rng, 9, 9, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    lattice = replace(lattice, traction_per_m=np.abs(lattice.traction_per_m[:, :, :1]) + np.ones(8, dtype=np.float32))
    lattice.blocked[:] = 0
    starts = 4 + rng.integers(0, 4, (50, 2)) / 4
    steps = move_offsets(32)[rng.integers(32, size=50)] / rng.choice([1, 2, 4], (50, 1))
    cells, shares = leg_stencils(np.hstack([starts, steps]))
    assert np.where(shares > 0.0, shares, 0.0).sum(axis=1) == pytest.approx(np.ones(50))
    traction = lattice.traction_per_m[cells[..., 0], cells[..., 1], 0]
    mean = np.where(shares >= 0.0, shares * traction, 0.0).sum(axis=1)
    length = np.hypot(*steps.T) * lattice.frame.resolution_m
    expected = (lattice.robot.hotel_per_m + mean) * length
    np.testing.assert_allclose(leg_prices_between(lattice, starts, starts + steps), expected, rtol=1e-6)


def test_a_passage_is_found_that_is_open_between_two_short_headings_only():
    cheaper = 0
    for seed in range(60):
        lattice, table, start, goal = random_task(seed, 9.0)
        found, _ = found_paths(lattice, table, start, goal)
        if found:
            most = least_energy(half_cell_graph(lattice, table, long=False), start, goal)
            cheaper += path_price(lattice, found[0]) < most - 0.02 * abs(most)
    assert cheaper > 0


def test_a_passage_is_found_far_from_the_best_path_over_grid_moves(monkeypatch):
    """A wall whose passage may be driven at 11 degrees only, between the headings of moves; the way around its end
    costs a tenth more, and lies beyond the cells near the passage."""
    lattice = uniform_lattice(31, 60, lambda heading: 1.0)
    lattice = replace(lattice, robot=replace(lattice.robot, max_cross_slope_deg=0.9, max_grade_deg=40.0))
    lattice.blocked[15, :32] = Blocked.STEP
    passage, heading = (15, slice(10, 12)), math.atan2(1.0, 5.0)
    lattice.blocked[passage] = Blocked.FREE
    lattice.gradient[passage] = 0.4 * math.sin(heading), 0.4 * math.cos(heading)
    task = lattice, move_table(lattice, neighbours=32), np.array([28.0, 20.0]), np.array([2.0, 20.0])
    found = best_path(*task)
    assert found.energy_j < 0.91 * found.grid_energy_j
    monkeypatch.setattr(corridors, "WIDER", 1.0)
    assert best_path(*task).energy_j > 0.99 * found.grid_energy_j


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
            patched.setattr(corridors, "paths_through_passages", lambda *_: [])
            before = planner.plan(*ends).route.energy_j
        ratios.append(now / before)
    assert max(ratios) <= 1.0 + 1e-4
    assert min(ratios) < 0.99
