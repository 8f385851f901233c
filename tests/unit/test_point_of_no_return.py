"""The last place of a path from which one comes home: what is found beside a look at every metre."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.planner.pricing.integrator import world_points
from joulemap.planner.route import pieces_of
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.verdict.point_of_no_return import WaysFrom, last_place
from joulemap.planner.verdict.trajectory import course_of_pieces
from tests.reference.lattices import random_lattice


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_last_metre_that_leaves_enough_for_home(seed: int) -> None:
    lattice = random_lattice(np.random.default_rng(seed), 40, 40)
    planner = RoutePlanner(lattice)
    home, goal = (tuple(float(v) for v in lattice.frame.xy(*place)) for place in ((5.0, 5.0), (34.0, 33.0)))
    route = planner.plan(home, goal, snap=True).route
    home = tuple(route.points[0, :2].tolist())
    cut = pieces_of(lattice, world_points(lattice, route.points))
    course = course_of_pieces(lattice, cut, (*home, 0.0))
    assert course.energy_j.sum() == pytest.approx(route.energy_j)
    field, ways = planner.energies_towards(home), WaysFrom(lattice, cut.points)
    rest = ways.energies(field, home, np.arange(len(course) + 1))
    back = np.array([field[tuple(np.rint(p).astype(int))] for p in cut.points])
    assert np.isfinite(rest).all()
    assert np.abs(rest - back)[2:].max() < 0.1 * back.max()  # of the next centre
    total = np.append(0.0, np.cumsum(course.energy_j)) + rest
    for share in (0.0, 0.3, 0.6, 0.9, 2.0):
        available = share * float(total[-1])
        found = last_place(
            course,
            lambda of: WaysFrom(lattice, cut.points).energies(field, home, of),
            available,
            odds=lambda _: None,
            confidence=None,
        )
        assert found.reachable == (total[0] <= available)
        if found.whole_path:
            assert total[-1] <= available
        elif found.reachable:
            last = int(np.flatnonzero(total <= available)[-1])
            assert found.last is not None
            assert found.last.distance_m == pytest.approx(course.distance_m[last - 1] if last else 0.0)
            assert found.cheapest_j == pytest.approx(rest[: last + 1].min(), abs=1e-6)
