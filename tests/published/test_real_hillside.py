"""A real heightmap (Malaga rescue area, 200 x 200 m): the searches agree, and no sampling planner beats them."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.grid.fields import field_from
from joulemap.planner.grid.graph import lattice_graph
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.pricing.integrator import path_price, world_points
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.lattices import price_world_path
from tests.reference.quadrature import leg_energy_by_midpoints

CROSSINGS = [((20.5, 179.5), (179.5, 20.5)), ((100.5, 15.5), (90.5, 189.5)), ((30.2, 60.7), (170.9, 120.3))]


@pytest.fixture(scope="module")
def hillside(real_data):
    heightmap = read_heightmap(real_data / "cuadriga" / "uma_rescue_area_1m.tif")
    lattice = build_lattice(heightmap, Robot(), PhysicsPredictor())
    west, south, _, _ = lattice.frame.bounds
    crossings = [((west + a, south + b), (west + c, south + d)) for (a, b), (c, d) in CROSSINGS]
    return lattice, crossings


def test_astar_equals_dijkstra_equals_networkx_on_16_neighbours(hillside):
    lattice, crossings = hillside
    table = move_table(lattice, neighbours=16)
    graph = lattice_graph(lattice, neighbours=16)
    for start, goal in crossings:
        cells = [lattice.frame.cell_of(*p) for p in (start, goal)]
        ends = [np.array(c, dtype=float) for c in cells]
        fast = grid_search(lattice, table, *ends)
        plain = grid_search(lattice, table, *ends, planner="dijkstra")
        slow = nx.dijkstra_path_length(graph, *cells, weight="energy_j")
        assert fast.energy_j == pytest.approx(plain.energy_j, rel=1e-9)
        assert fast.energy_j == pytest.approx(slow, rel=1e-6)
        assert path_price(lattice, fast.points) == pytest.approx(fast.energy_j, rel=1e-6)
        assert fast.expanded < plain.expanded


def bellman_ford(table, shape, source):
    """Least energies from a cell over a move table, by whole-array relaxation until nothing changes."""
    least = np.full(shape, np.inf)
    least[source] = 0.0
    rows, cols = shape
    for _ in range(rows * cols):
        before = least.copy()
        for n, (d_row, d_col) in enumerate(table.offsets):
            to = np.s_[max(d_row, 0) : rows + min(d_row, 0), max(d_col, 0) : cols + min(d_col, 0)]
            came = np.s_[max(-d_row, 0) : rows + min(-d_row, 0), max(-d_col, 0) : cols + min(-d_col, 0)]
            reached = least[came] + table.energy[(*came, n)].astype(np.float64)
            least[to] = np.fmin(least[to], reached)
        if (least == before).all():
            return least
    raise AssertionError("a negative cycle")


@pytest.mark.parametrize("regeneration", [0.3, 0.5])
def test_regeneration_on_rough_ground_is_bellman_fords_answer(hillside, regeneration):
    lattice, crossings = hillside
    lattice = replace(lattice, robot=replace(lattice.robot, regeneration=regeneration))
    table = move_table(lattice, neighbours=16)
    assert np.nanmin(table.energy) < 0.0
    start, goal = crossings[0]
    cells = [lattice.frame.cell_of(*p) for p in (start, goal)]
    ends = [np.array(c, dtype=float) for c in cells]
    slow = bellman_ford(table, lattice.frame.shape, cells[0])
    for planner in ("astar", "dijkstra"):
        assert grid_search(lattice, table, *ends, planner=planner).energy_j == pytest.approx(slow[cells[1]], rel=1e-9)
    np.testing.assert_allclose(field_from(lattice, table, ends[0]).energy_j, slow, rtol=1e-9, atol=1e-6)
    exact = replace(lattice, robot=replace(lattice.robot, tracking_std_m=0.0))  # moves over the grid keep no margin
    plan = RoutePlanner(exact).plan(start, goal)
    assert plan.route.energy_j <= plan.details["grid_energy_j"]


def test_routes_are_priced_as_claimed_both_ways_and_beat_the_shortest(hillside):
    lattice, crossings = hillside
    planner = RoutePlanner(lattice)
    for start, goal in crossings[:2]:
        plan = planner.plan(start, goal)
        for route in (plan.route, plan.shortest):
            xy = route.points[:, :2]
            assert route.energy_j == pytest.approx(price_world_path(lattice, xy), rel=1e-6)
            assert route.energy_j == pytest.approx(route.profile.energy_j.sum(), rel=1e-6)
            there = sum(
                leg_energy_by_midpoints(lattice, a, b, points=300) for a, b in zip(xy[:-1], xy[1:], strict=True)
            )
            assert route.energy_j == pytest.approx(there, rel=1e-4)
            back = sum(leg_energy_by_midpoints(lattice, b, a, points=300) for a, b in zip(xy[:-1], xy[1:], strict=True))
            assert price_world_path(lattice, xy[::-1]) == pytest.approx(back, rel=1e-4)
        assert plan.route.energy_j <= plan.shortest.energy_j
        assert plan.route.energy_j <= plan.details["grid_energy_j"] * (1 + 1e-9)
        assert plan.shortest.length_m <= plan.route.length_m


@pytest.mark.parametrize(
    "sampler", [*(pytest.param(name, marks=pytest.mark.slow) for name in ("rrtstar", "informed_rrtstar")), "bitstar"]
)
def test_sampling_planners_never_beat_the_improved_grid_path_by_a_hundredth(hillside, sampler):
    lattice, crossings = hillside
    planner = RoutePlanner(lattice)
    start, goal = crossings[0]
    best = planner.plan(start, goal).route
    try:
        sampled = planner.plan(start, goal, RouteOptions(planner=sampler, time_limit_s=6.0, refine=False)).route
    except NoRouteError:  # a busy machine: this crossing takes a tree some seconds of work
        sampled = planner.plan(start, goal, RouteOptions(planner=sampler, time_limit_s=60.0, refine=False)).route
    assert sampled.energy_j == pytest.approx(price_world_path(lattice, sampled.points), rel=1e-9)
    np.testing.assert_allclose(world_points(lattice, sampled.points)[[0, -1]], world_points(lattice, [start, goal]))
    assert 0.99 * best.energy_j <= sampled.energy_j <= 1.5 * best.energy_j


def test_a_sampling_planner_answers_with_the_shortest_path_where_it_has_nothing_better(hillside):
    lattice, crossings = hillside
    assert (
        RoutePlanner(lattice)
        .plan(*crossings[0], RouteOptions(planner="bitstar", time_limit_s=1.0, refine=False))
        .saving_j
        >= 0.0
    )
