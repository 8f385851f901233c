"""Where a route may begin or end: the nearest free place is found, named and gone to."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import BlockedError, PointError
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.places import nearest_free
from joulemap.planner.pricing.integrator import leg_prices_between
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.reference.lattices import ascii_lattice, plane_lattice

ROBOT = Robot(max_grade_deg=25.0, max_cross_slope_deg=20.0)
ROOM = """
    ..........
    .a..###...
    ....###.b.
    ....###...
    ..........
"""


def test_a_blocked_start_or_goal_names_the_nearest_free_place():
    lattice, at = ascii_lattice(ROOM)
    planner = RoutePlanner(lattice)
    words = r"start .* is on blocked ground: step; the nearest free place is \(3\.50, 2\.50\), 1\.30 m away"
    with pytest.raises(BlockedError, match=words) as said:
        planner.plan((4.8, 2.5), at["b"])
    assert said.value.context["nearest"] == [3.5, 2.5]
    assert said.value.context["nearest_m"] == pytest.approx(1.3)
    assert said.value.context["reason"] == "step"
    json.dumps(said.value.context)
    with pytest.raises(BlockedError, match=r"goal .* is on blocked ground"):
        planner.plan(at["a"], (5.5, 2.5))


@pytest.mark.parametrize("planner", ["astar", "dijkstra"])
def test_with_snap_a_plan_goes_to_the_nearest_free_place_and_says_so(planner):
    lattice, at = ascii_lattice(ROOM)
    plan = RoutePlanner(lattice).plan((4.8, 2.5), (5.5, 1.9), RouteOptions(planner=planner, snap=True))
    np.testing.assert_allclose(plan.route.points[0, :2], [3.5, 2.5])
    np.testing.assert_allclose(plan.route.points[-1, :2], [5.5, 0.5])
    first, second = plan.route.notes
    assert first == (
        "start (4.80, 2.50) is on blocked ground (step) and was moved to the nearest free place, (3.50, 2.50), "
        "1.30 m away"
    )
    assert second.startswith("goal (5.50, 1.90) is on blocked ground")
    free = RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(snap=True))
    assert free.route.notes == []
    np.testing.assert_allclose(free.route.points[[0, -1], :2], [at["a"], at["b"]])
    with pytest.raises(PointError, match="outside"):  # no free place is meant there
        RoutePlanner(lattice).plan(at["a"], (99.0, 2.5), RouteOptions(snap=True))


def test_a_free_cell_without_a_way_out_is_no_place_to_go_to():
    lattice, _ = ascii_lattice("""
        ########
        ##.##...
        ########
    """)
    x, y, away_m = nearest_free(lattice, 1.5, 1.5)  # the free cell beside it is walled in
    assert (x, y) == (5.5, 1.5)
    assert away_m == pytest.approx(4.0)


def test_ground_that_is_too_steep_in_every_heading_is_no_place_to_go_to():
    lattice = plane_lattice(3, 30, robot=ROBOT)
    gradient = lattice.gradient.copy()
    gradient[:, :20, 0] = 1.5  # 56 degrees: the robot may climb 25 and cross 20
    steep = replace(lattice, gradient=gradient)
    with pytest.raises(BlockedError, match="grade") as said:
        RoutePlanner(steep).plan((2.5, 1.5), (28.5, 1.5))
    assert said.value.context["nearest"] == [20.5, 1.5]
    assert RoutePlanner(steep).plan((2.5, 1.5), (28.5, 1.5), RouteOptions(snap=True)).route.points[0, 0] == 20.5


def test_where_nothing_is_free_the_message_says_so():
    lattice, _ = ascii_lattice("####\n####\n####")
    assert nearest_free(lattice, 1.5, 1.5) is None
    with pytest.raises(BlockedError, match="no free place near it") as said:
        RoutePlanner(lattice).plan((1.5, 1.5), (2.5, 1.5), RouteOptions(snap=True))
    assert "nearest" not in said.value.context


def test_the_search_is_bounded_and_looks_no_further_than_it_must(monkeypatch):
    lattice, _ = ascii_lattice("\n".join(["#" * 39 + "."] * 40))
    assert nearest_free(lattice, 0.5, 20.5, furthest_cells=10) is None
    assert nearest_free(lattice, 0.5, 20.5) == (39.5, 20.5, pytest.approx(39.0))
    windows = []
    whole = CostLattice.blocked_by_heading
    monkeypatch.setattr(CostLattice, "blocked_by_heading", lambda self: windows.append(self.frame.shape) or whole(self))
    open_ground, _ = ascii_lattice("\n".join(["." * 40] * 20 + ["#" * 40] + ["." * 40] * 19))
    nearest_free(open_ground, 20.5, 19.5)
    assert windows == [(1, 1)]  # one cell was asked for all its headings


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.3, 0.7, 0.97]))
def test_nearest_free_is_the_nearest_of_all(seed, share):
    """Against a look at every cell of the map."""
    rng = np.random.default_rng(seed)
    lattice = plane_lattice(23, 17, robot=ROBOT)
    blocked = np.where(rng.random((23, 17)) < share, np.uint8(Blocked.STEP), np.uint8(0))
    lattice = replace(lattice, blocked=blocked)
    x, y = rng.uniform(0, 17), rng.uniform(0, 23)
    distances = []
    for row, col in np.argwhere(blocked == 0):
        around = [(row + r, col + c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)]
        ends = np.array(around, dtype=float)
        legs = leg_prices_between(lattice, np.broadcast_to(np.array([row, col], dtype=float), ends.shape).copy(), ends)
        if np.isfinite(legs).any():
            here_x, here_y = lattice.frame.xy(row, col)
            distances.append(np.hypot(here_x - x, here_y - y))
    found = nearest_free(lattice, x, y)
    assert (found is None) == (not distances)
    if found is not None:
        assert found[2] == pytest.approx(min(distances))
        assert np.hypot(found[0] - x, found[1] - y) == pytest.approx(found[2])
