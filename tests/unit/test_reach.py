"""Reach: where the battery lasts to, as planning to every cell would say it."""

import numpy as np
import pytest

from joulemap.model.robot import Robot
from joulemap.planner.areas.reach import peak_need
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.route_planner import RoutePlanner
from tests.reference.lattices import ascii_lattice, plane_lattice, random_lattice

ROVER = Robot(idle_power_w=0.0, max_grade_deg=30.0, max_cross_slope_deg=30.0)


def world(lattice: CostLattice, cell: Points) -> tuple[float, float]:
    x, y = lattice.frame.xy(float(cell[0]), float(cell[1]))
    return float(x), float(y)


def planned_j(planner: RoutePlanner, here: Points, there: Points, *, round_trip: bool) -> float:
    ends = world(planner.lattice, here), world(planner.lattice, there)
    legs = [ends, ends[::-1]] if round_trip else [ends]
    return peak_need([planner.plan(*leg).route for leg in legs])


def test_on_a_plane_the_reach_is_where_the_closed_form_says() -> None:
    """A tilted plane: the straight line costs m g (mu L + rise), which is never negative here."""
    lattice = plane_lattice(61, 61, rise_east=0.05, robot=ROVER)
    found, _ = RoutePlanner(lattice).reach((30.5, 30.5))
    row, col = np.mgrid[0:61, 0:61]
    needed = ROVER.weight_n * (ROVER.rolling_resistance * np.hypot(row - 30, col - 30) + 0.05 * (col - 30))
    step = ROVER.weight_n * (ROVER.rolling_resistance + 0.05)  # of a cell, uphill
    for metres in (8.0, 15.0, 25.0):
        available = ROVER.weight_n * ROVER.rolling_resistance * metres
        unlike = (found.margin_j(available) >= 0.0) != (needed <= available)
        assert (np.abs(needed[unlike] - available) < step).all()


@pytest.mark.parametrize(("seed", "round_trip", "robot"), [
    (1, False, {}),
    (2, True, {}),
    (3, False, {"turn_j_per_rad": 30.0}),
    (4, True, {"regeneration": 0.5}),
])  # fmt: skip
def test_it_says_what_planning_to_each_goal_says(seed: int, round_trip: bool, robot: dict[str, float]) -> None:
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 60, 60, **robot)
    planner = RoutePlanner(lattice)
    free = np.argwhere(lattice.blocked == 0)
    start = free[np.argmin(np.hypot(*(free - 30).T))].astype(float)
    found, _ = planner.reach(world(lattice, start), round_trip=round_trip)
    available = float(np.percentile(found.base_j[np.isfinite(found.base_j)], 50))
    margin = found.margin_j(available)
    inside = margin >= 0.0
    rim = np.zeros_like(inside)
    for down in (-1, 0, 1):  # within a cell of the border
        for right in (-1, 0, 1):
            rim |= np.roll(inside, (down, right), (0, 1)) != inside
    near = np.argwhere(~rim & (np.abs(margin) < 0.3 * available))
    for goal in near[rng.choice(len(near), 25, replace=False)]:
        needed = planned_j(planner, start, goal.astype(float), round_trip=round_trip)
        assert (needed <= available) == inside[tuple(goal)], goal


def test_it_grows_with_the_energy_and_shrinks_with_what_is_needed() -> None:
    lattice = random_lattice(np.random.default_rng(5), 60, 60)
    planner = RoutePlanner(lattice)
    start = world(lattice, np.argwhere(lattice.blocked == 0)[1500])
    found, _ = planner.reach(start)
    back, _ = planner.reach(start, round_trip=True)
    most = float(np.max(found.base_j[np.isfinite(found.base_j)]))
    before = np.zeros(lattice.frame.shape, dtype=bool)
    for available in np.geomspace(most / 50.0, most, 23):
        inside = found.margin_j(available) >= 0.0
        assert not (before & ~inside).any()
        sure = found.margin_j(available, need=lambda routes: 1.2 * peak_need(routes)) >= 0.0
        assert not (sure & ~inside).any()
        assert not ((back.margin_j(available) >= 0.0) & ~inside).any()
        before = inside
    assert (before == np.isfinite(found.base_j)).all()
    assert not (found.margin_j(-1.0) >= 0.0).any()
    assert planner.reach(start)[0] is found


def test_the_way_back_up_counts() -> None:
    """Downhill to the east costs nothing; coming back climbs: m g (mu L + rise) for the way up alone."""
    lattice = plane_lattice(21, 61, rise_east=-0.2, robot=ROVER)
    planner = RoutePlanner(lattice)
    out, back = (planner.reach((30.5, 10.5), round_trip=trip)[0] for trip in (False, True))
    uphill = ROVER.weight_n * (ROVER.rolling_resistance + 0.2)
    inside = back.margin_j(10.5 * uphill)[10] >= 0.0
    assert np.flatnonzero(inside).max() == 40
    assert (out.margin_j(1.0)[10, 31:] >= 0.0).all()


def test_outlines_close_at_walls_and_at_the_rim_of_the_map_and_have_holes() -> None:
    lattice, at = ascii_lattice("""
        ........#...
        ........#...
        ..a.....#...
        ....##..#...
        ....##..#...
        ........#...
        """)
    found, _ = RoutePlanner(lattice).reach(at["a"])
    margin = found.margin_j(100.0)
    reach = ReachMap(lattice.frame, at["a"], (1.0,), (100.0,), False, None, margin[None], {})
    assert reach.area_m2() == 8 * 6 - 4
    (part,) = reach.polygons()
    outer, hole = part
    assert np.allclose(outer[0], outer[-1])
    area = [0.5 * float((r[:-1, 0] * r[1:, 1] - r[1:, 0] * r[:-1, 1]).sum()) for r in (outer, hole)]
    assert area[0] == pytest.approx(48.0, abs=2.5)
    assert area[1] == pytest.approx(-4.0, abs=2.5)
    assert reach.margin_at(11.5, 0.5) != reach.margin_at(11.5, 0.5)  # no route leads there
    assert reach.to_xarray()["margin_j"].dims == ("charge", "y", "x")
    nothing = ReachMap(lattice.frame, at["a"], (0.0,), (-1.0,), False, None, found.margin_j(-1.0)[None], {})
    assert nothing.polygons() == []
