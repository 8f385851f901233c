"""The search over line points: as cheap as that of networkx over the same chords, each priced by itself."""

import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.planner.any_angle.chords import chords_of
from joulemap.planner.any_angle.line_points import cheapest_over_line_points
from joulemap.planner.pricing.integrator import driven_prices, leg_prices_between, path_price
from tests.reference.lattices import random_lattice

ROWS, COLS = 5, 6


def chord_graph(lattice, region, parts):
    """Every chord between line points of the region's squares, priced one by one; places are counted in parts."""
    legs = []
    for i, j in np.ndindex(ROWS - 1, COLS - 1):
        whole = range(parts + 1)
        border = [(a, b) for a in whole for b in whole if a in (0, parts) or b in (0, parts)]
        for a in border:
            for b in border:
                side = [k for k in (0, 1) if a[k] == b[k] and a[k] in (0, parts)]
                touched = region[i : i + 2, j : j + 2]
                for k in side:
                    touched = touched.take([a[k] // parts], axis=k)  # along a side two cells count
                if a != b and touched.all() and (not side or math.dist(a, b) == 1.0):
                    legs.append([*(i * parts + a[0], j * parts + a[1]), *(i * parts + b[0], j * parts + b[1])])
    legs = np.unique(np.array(legs).reshape(-1, 4), axis=0)
    prices = leg_prices_between(lattice, legs[:, :2] / parts, legs[:, 2:] / parts)
    graph = nx.DiGraph()
    for leg, price in zip(legs.tolist(), prices.tolist(), strict=True):
        if math.isfinite(price):
            graph.add_edge(tuple(leg[:2]), tuple(leg[2:]), energy_j=price)
    return graph


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    limit=st.sampled_from([8.0, 14.0, 30.0]),
    regeneration=st.sampled_from([0.0, 0.4]),
    parts=st.sampled_from([2, 4, 8]),
)
def test_it_is_the_cheapest_way_over_all_chords(seed, limit, regeneration, parts):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, ROWS, COLS, max_grade_deg=limit, max_cross_slope_deg=limit)
    lattice = replace(lattice, robot=replace(lattice.robot, regeneration=regeneration))
    region = rng.random((ROWS, COLS)) < 0.9
    start, goal = rng.integers(0, [ROWS, COLS]), rng.integers(0, [ROWS, COLS])
    if (start == goal).all():
        return
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    for row, col in (start, goal):  # both are joined to the line points of all squares around them
        region[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = True
    prices = driven_prices(lattice, 20.0)
    found = cheapest_over_line_points(
        lattice, prices, region, start.astype(float), goal.astype(float), parts=parts, typical_j=20.0
    )
    graph = chord_graph(lattice, region, parts)
    ends = tuple((start * parts).tolist()), tuple((goal * parts).tolist())
    if not all(end in graph for end in ends) or not nx.has_path(graph, *ends):
        assert not len(found)
        return
    least = nx.bellman_ford_path_length(graph, *ends, weight="energy_j")
    assert path_price(lattice, found) == pytest.approx(least, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("width", [1e-3, 1.0, 1e3])
def test_the_width_of_a_bucket_changes_nothing(width):
    lattice = random_lattice(np.random.default_rng(2), 20, 20, max_grade_deg=20.0, max_cross_slope_deg=20.0)
    lattice.blocked[2, 2] = lattice.blocked[17, 16] = 0
    task = (
        lattice,
        driven_prices(lattice, 20.0),
        np.ones((20, 20), dtype=bool),
        np.array([2.0, 2.0]),
        np.array([17.0, 16.0]),
    )
    usual, other = (cheapest_over_line_points(*task, parts=4, typical_j=j) for j in (20.0, 20.0 * width))
    assert len(usual)
    assert path_price(lattice, other) == pytest.approx(path_price(lattice, usual), rel=1e-6)


def test_chords_have_one_length_and_heading_each_and_shares_that_sum_to_one():
    chords = chords_of(8)
    assert len(chords.places) == 15
    assert len(chords.heading_rad) == 176
    assert chords.share.sum(axis=1) == pytest.approx(np.ones(len(chords.length)))
    assert chords.blend.sum(axis=2) == pytest.approx(np.ones((len(chords.length), 3)))
    down, right = np.divmod(chords.cell.astype(np.int64), 3)
    begins = np.repeat(np.arange(15), np.diff(chords.first))
    steps = np.column_stack([down - 1, right - 1]) + chords.places[chords.kind] - chords.places[begins]
    assert np.hypot(*steps.T) == pytest.approx(chords.length)
    east, north = chords.directions[chords.heading].T
    assert steps / chords.length[:, None] == pytest.approx(np.column_stack([-north, east]))
