"""The cheapest way over several polylines: that of an independent search over the same vertices, and never dearer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from joulemap.model.robot import Robot
from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import leg_prices_between, path_price
from joulemap.planner.polylines import path_length, subdivided
from tests.reference.lattices import ascii_lattice, random_lattice


def open_lattice(rng, robot):
    """Random hills on which any leg may be driven."""
    robot = replace(robot, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    return replace(random_lattice(rng, 30, 40), blocked=np.zeros((30, 40), dtype=np.uint8), robot=robot)


def lines_between(rng, ends, count, shift=2.0):
    """Polylines that wind around the straight line between two places."""
    along = np.linspace(0.0, 1.0, 12)[:, None]
    straight = (1.0 - along) * ends[0] + along * ends[1]
    lines = []
    for _ in range(count):
        moved = straight + rng.normal(0.0, shift, straight.shape)
        moved[0], moved[-1] = ends
        lines.append(moved)
    return lines


@pytest.mark.parametrize("near", [0.7, 1.0, 2.5])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_cheapest_over_all_legs_between_vertices_that_are_near(seed, near):
    rng = np.random.default_rng(seed)
    lattice = open_lattice(rng, Robot())
    lines = lines_between(rng, np.array([(15.0, 4.0), (14.0, 35.0)]), 3)
    found = with_crossovers(lattice, lines[0], lines[1:], near=near)
    vertices = [subdivided(line, 0.5) for line in lines]
    places = np.vstack(vertices)
    pairs = KDTree(places).query_pairs(near, output_type="ndarray")
    a, b = np.vstack([pairs, pairs[:, ::-1]]).T
    prices = leg_prices_between(lattice, places[a], places[b])
    graph = coo_array((np.maximum(prices, 1e-12), (a, b)), shape=(len(places), len(places)))
    least = dijkstra(graph.tocsr(), indices=0)[len(vertices[0]) - 1]
    assert path_price(lattice, found) == pytest.approx(least, rel=1e-9)
    np.testing.assert_array_equal(found[[0, -1]], lines[0][[0, -1]])


def test_of_two_paths_with_a_detour_each_neither_is_left():
    lattice = ascii_lattice("\n".join(["." * 40] * 20))[0]
    one = np.array([(10.0, 2.0), (4.0, 8.0), (10.0, 14.0), (10.0, 37.0)])
    other = np.array([(10.0, 2.0), (10.0, 22.0), (16.0, 28.0), (10.0, 37.0)])
    assert path_length(with_crossovers(lattice, one, [other])) == pytest.approx(35.0)


def test_a_part_that_begins_and_ends_on_the_path_is_enough_and_a_place_too():
    lattice = ascii_lattice("\n".join(["." * 40] * 20))[0]
    round_about = np.array([(10.0, 2.0), (10.0, 10.0), (5.0, 12.0), (10.0, 14.0), (10.0, 37.0)])
    part = np.array([(10.0, 9.0), (10.0, 15.0)])
    assert path_length(with_crossovers(lattice, round_about, [part])) == pytest.approx(35.0)
    place = np.array([(10.0, 12.0)])
    assert path_length(with_crossovers(lattice, round_about, [place], near=2.0)) == pytest.approx(35.0)


@pytest.mark.parametrize("robot", [Robot(turn_j_per_rad=5.0), Robot(regeneration=0.5)])
def test_it_is_never_dearer_where_turning_costs_or_descents_give_energy_back(robot):
    cheaper = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lattice = open_lattice(rng, robot)
        lines = lines_between(rng, np.array([(15.0, 4.0), (14.0, 35.0)]), 4)
        energy = path_price(lattice, with_crossovers(lattice, lines[0], lines[1:]))
        assert energy <= path_price(lattice, lines[0])
        cheaper += energy < path_price(lattice, lines[0])
    assert cheaper > 6


def test_with_nothing_else_it_is_the_path_itself():
    lattice = ascii_lattice("\n".join(["." * 10] * 10))[0]
    path = np.array([(1.0, 1.0), (8.0, 8.0)])
    assert with_crossovers(lattice, path, []) is path


def test_a_path_that_may_not_be_driven_stays_as_it_is():
    lattice = ascii_lattice("\n".join(["." * 20] * 3 + ["#" * 20] + ["." * 20] * 3))[0]
    path = np.array([(1.0, 1.0), (5.0, 18.0)])
    assert with_crossovers(lattice, path, [path + 0.25]) is path
