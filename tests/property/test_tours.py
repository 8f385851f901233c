"""Tours: no order of the stops costs less, on ground that is not the same both ways."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import BlockedError, InputError, NoRouteError
from joulemap.planner.grid.search import grid_search
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.questions.tours import cheapest_tour
from tests.reference.lattices import ascii_lattice, random_lattice


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6), count=st.integers(2, 6), regeneration=st.sampled_from([0.0, 0.4]), one_way=st.booleans()
)
def test_no_order_costs_less(seed, count, regeneration, one_way):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 20, 20, regeneration=regeneration)
    table = move_table(lattice)
    stops = rng.uniform(0.0, 19.0, (count, 2))
    try:
        tour = cheapest_tour(lattice, table, stops, one_way=one_way)
        as_given = cheapest_tour(lattice, table, stops, one_way=one_way, in_order=True)
    except (NoRouteError, BlockedError):
        return
    energy = np.array(
        [
            [0.0 if i == j else grid_search(lattice, table, a, b).energy_j for j, b in enumerate(stops)]
            for i, a in enumerate(stops)
        ]
    )
    if one_way:
        energy[count - 1, 0] = 0.0  # closes the circle
    orders = [order for order in permutations(range(1, count)) if not one_way or order[-1] == count - 1]
    sums = [sum(energy[a, b] for a, b in zip((0, *order), (*order, 0), strict=True)) for order in orders]
    best = min(sums)
    assert as_given.energy_j == pytest.approx(sums[0], rel=1e-6)
    assert tour.energy_j == pytest.approx(best, rel=1e-6)
    assert tour.bound_j <= tour.energy_j * (1 + 1e-6) + 1e-3
    assert tour.order[0] == 0
    assert sorted(tour.order) == list(range(count))
    for k, path in enumerate(tour.paths):
        np.testing.assert_array_equal(path.points[0], stops[tour.order[k]])
        np.testing.assert_array_equal(path.points[-1], stops[tour.order[(k + 1) % count]])
        assert path_price(lattice, path.points) == pytest.approx(path.energy_j, rel=1e-6, abs=1e-3)


def test_stops_that_no_route_joins_are_named():
    lattice, at = ascii_lattice("""
        .a.#...
        .b.#.c.
    """)
    stops = np.array([lattice.frame.rowcol(*at[name]) for name in "abc"])
    with pytest.raises(NoRouteError, match="from stop 2 to stop 0"):
        cheapest_tour(lattice, move_table(lattice), stops)
    with pytest.raises(InputError, match="2 to 60"):
        cheapest_tour(lattice, move_table(lattice), stops[:1])
