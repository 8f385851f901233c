"""A* = Dijkstra = networkx on random lattices, with turning, regeneration, blocked cells and limits."""

from contextlib import suppress

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import BlockedError, NegativeCycleError, NoRouteError
from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.grid.graph import lattice_graph
from joulemap.planner.grid.heuristics import guide_everywhere
from joulemap.planner.grid.search import grid_search
from joulemap.planner.grid.states import layer_count, new_search, run_search
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from tests.reference.lattices import random_lattice


def states_graph(lattice, neighbours):
    """(cell, heading of arrival) states: the slow reference for turning."""
    graph = lattice_graph(lattice, neighbours=neighbours)
    out = nx.DiGraph()
    for a, b, data in graph.edges(data=True):
        heading = np.arctan2(b[1] - a[1], a[0] - b[0])
        for c in graph.predecessors(a):
            before = np.arctan2(a[1] - c[1], c[0] - a[0])
            turn = abs(np.angle(np.exp(1j * (heading - before))))
            energy = data["energy_j"] + turn * lattice.robot.turn_j_per_rad
            out.add_edge((c, a), (a, b), energy_j=energy)
        out.add_edge(("from", a), (a, b), energy_j=data["energy_j"])
        out.add_edge((a, b), ("to", b), energy_j=0.0)
    return out


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    neighbours=st.sampled_from([8, 16, 32]),
    regeneration=st.sampled_from([0.0, 0.0, 0.5]),
    turn=st.sampled_from([0.0, 0.0, 30.0]),
    limit=st.sampled_from([12.0, 30.0]),
    idle=st.sampled_from([0.0, 12.0]),
)
def test_astar_equals_dijkstra_equals_networkx(seed, neighbours, regeneration, turn, limit, idle):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(
        rng, 9, 11, regeneration=regeneration, turn_j_per_rad=turn, max_grade_deg=limit, idle_power_w=idle
    )
    start, goal = rng.integers(0, [9, 11]), rng.integers(0, [9, 11])
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    try:
        table = move_table(lattice, neighbours=neighbours)
    except NegativeCycleError:
        assert nx.negative_edge_cycle(lattice_graph(lattice, neighbours=neighbours), weight="energy_j")
        return
    reference = states_graph(lattice, neighbours) if turn else lattice_graph(lattice, neighbours=neighbours)
    a, b = tuple(start.tolist()), tuple(goal.tolist())
    ends = (("from", a), ("to", b)) if turn else (a, b)
    try:
        found = grid_search(lattice, table, start.astype(float), goal.astype(float))
    except NoRouteError:
        assert not all(reference.has_node(e) for e in ends) or not nx.has_path(reference, *ends)
        return
    slow = 0.0 if a == b else nx.bellman_ford_path_length(reference, *ends, weight="energy_j")
    assert found.energy_j == pytest.approx(slow, rel=1e-6, abs=1e-4)
    other = grid_search(lattice, table, start.astype(float), goal.astype(float), planner="dijkstra")
    assert other.energy_j == pytest.approx(found.energy_j, rel=1e-9, abs=1e-6)
    assert path_price(lattice, found.points) == pytest.approx(found.energy_j, rel=1e-6, abs=1e-3)
    refined = improved(lattice, found.points)
    assert path_price(lattice, refined) <= path_price(lattice, found.points) + 1e-9
    np.testing.assert_array_equal(refined[[0, -1]], found.points[[0, -1]])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    share=st.floats(0.0, 1.0),
    turn=st.sampled_from([0.0, 30.0]),
    regeneration=st.sampled_from([0.0, 0.5]),
    backward=st.booleans(),
)
def test_a_search_that_ended_early_goes_on_from_its_open_cells(seed, share, turn, regeneration, backward):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 12, 13, turn_j_per_rad=turn, regeneration=regeneration)
    try:
        table = move_table(lattice, neighbours=16)
    except NegativeCycleError:
        return
    cell, layers = rng.integers(0, 12 * 13, size=1), layer_count(lattice, table)
    guide = guide_everywhere(table, backward=backward)
    whole, parts = (new_search(table, layers, cell, np.zeros((1, layers)), backward=backward) for _ in range(2))
    run_search(whole, table, cell, guide)
    reached = whole.energy_j[np.isfinite(whole.energy_j)]
    run_search(parts, table, cell, guide, most=float(np.quantile(reached, share)))
    run_search(parts, table, parts.reached_cells(open_only=True), guide)
    np.testing.assert_allclose(parts.energy_j, whole.energy_j, rtol=1e-9, atol=1e-6)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), turn=st.sampled_from([0.0, 50.0]))
def test_any_start_and_goal_inside_the_map_are_priced_as_they_are_claimed(seed, turn):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 12, 12, turn_j_per_rad=turn)
    table = move_table(lattice, neighbours=16)
    start, goal = rng.uniform(-0.5, 11.5, 2), rng.uniform(-0.5, 11.5, 2)
    try:
        found = grid_search(lattice, table, start, goal)
    except (NoRouteError, BlockedError):
        return
    np.testing.assert_allclose(found.points[[0, -1]], [start, goal])
    assert path_price(lattice, found.points) == pytest.approx(found.energy_j, rel=1e-6)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), regeneration=st.sampled_from([0.0, 0.5]))
def test_fields_are_networkx_from_one_cell_to_all_and_from_all_to_one(seed, regeneration):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 8, 8, regeneration=regeneration)
    lattice.blocked[0, 0] = 0
    table = move_table(lattice, neighbours=16)
    graph = lattice_graph(lattice, neighbours=16)
    for field, view in (
        (field_from(lattice, table, np.zeros(2)), graph),
        (field_towards(lattice, table, np.zeros((1, 2))), graph.reverse()),
    ):
        lengths = nx.single_source_bellman_ford_path_length(view, (0, 0), weight="energy_j")
        for cell in np.ndindex(8, 8):
            if cell in lengths:
                assert field.energy_j[cell] == pytest.approx(lengths[cell], rel=1e-6, abs=1e-4)
            else:
                assert np.isinf(field.energy_j[cell])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), turn=st.sampled_from([0.0, 50.0]), regeneration=st.sampled_from([0.0, 0.5]))
def test_a_field_towards_goals_answers_every_start_as_a_search_would(seed, turn, regeneration):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 10, 10, turn_j_per_rad=turn, regeneration=regeneration)
    table = move_table(lattice, neighbours=16)
    goals = rng.uniform(0.0, 9.0, (int(rng.integers(1, 4)), 2))
    try:
        field = field_towards(lattice, table, goals)
    except BlockedError:
        return
    for start in rng.uniform(-0.5, 9.5, (4, 2)):
        found = []
        for goal in goals:
            with suppress(NoRouteError):
                found.append(grid_search(lattice, table, start, goal).energy_j)
        if not found:
            with pytest.raises(NoRouteError):
                field.path_from(start)
            continue
        path = field.path_from(start)
        assert path.energy_j == pytest.approx(min(found), rel=1e-9, abs=1e-6)
        assert path_price(lattice, path.points) <= path.energy_j * (1 + 1e-6) + 1e-3  # turns at a joint may be fewer
        np.testing.assert_array_equal(path.points[0], start)
        assert (path.points[-1] == goals).all(axis=1).any()
