"""Batteries along ways: summits out of reach, the last place to come home from, and chains of charging places."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.battery import Battery
from joulemap.planner.pricing.integrator import world_points
from joulemap.planner.questions.charging import Charging, cheapest_chain
from joulemap.planner.route import pieces_of
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.planner.verdict.budget import judge
from joulemap.service.analysis.homeward import homeward
from tests.reference.lattices import random_lattice

PIECES = st.lists(st.floats(-5000.0, 5000.0), min_size=1, max_size=30)


def test_a_summit_that_is_out_of_reach() -> None:
    """1 Wh = 3600 J: 4000 J up and 1000 J back cost 3000 J in all, but the battery is empty before the summit."""
    verdict = judge([4000.0, -1000.0], Battery(1.0))
    assert judge(3000.0, Battery(1.0)).feasible
    assert (verdict.feasible, verdict.energy_j, verdict.shortfall_j) == (False, 3000.0, 400.0)


@given(pieces=PIECES, charge=st.floats(0.0, 1.0), reserve=st.floats(0.0, 1.0))
def test_against_a_plain_walk(pieces: list[float], charge: float, reserve: float) -> None:
    battery = Battery(2.0, charge=charge, reserve=reserve)
    verdict = judge(pieces, battery)
    left = lowest = battery.available_j
    for piece in pieces:
        left = min(left - piece, (1.0 - reserve) * 7200.0)
        lowest = min(lowest, left)
    assert verdict.margin_j - verdict.shortfall_j == pytest.approx(lowest, abs=1e-6)
    assert verdict.energy_j == pytest.approx(float(np.sum(pieces)))


CAPACITY_WH = 1000.0


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_last_metre_that_leaves_enough_for_home(seed: int) -> None:
    lattice = random_lattice(np.random.default_rng(seed), 40, 40)
    planner = RoutePlanner(lattice)
    home, goal = (tuple(float(v) for v in lattice.frame.xy(*place)) for place in ((5.0, 5.0), (34.0, 33.0)))
    route = planner.plan(home, goal, RouteOptions(snap=True)).route
    home, path = tuple(route.points[0, :2].tolist()), route.points[:, :2]
    ways = planner.ways_towards(home)
    points = pieces_of(lattice, world_points(lattice, route.points)).points
    back = np.array([ways.path_from(point).energy_j for point in points])
    total = np.append(0.0, route.profile.cumulative_j) + back
    assert np.isfinite(total).all()
    for share in (0.0, 0.3, 0.6, 0.9, 2.0):
        available = share * float(total[-1])
        battery = Battery(CAPACITY_WH, charge=available / CAPACITY_WH / 3600.0)
        found = homeward(planner, home, home, battery, path=path, charging=[home], confidence=None)
        assert found.home.reachable == (total[0] <= available)
        if found.home.whole_path:
            assert total[-1] <= available * (1.0 + 1e-9)
        elif found.home.reachable:
            last = int(np.flatnonzero(total <= available)[-1])
            assert found.home.last is not None
            assert found.home.last.distance_m == pytest.approx(route.profile.distance_m[last - 1] if last else 0.0)
            assert found.charging[0].cheapest_j == pytest.approx(back[: last + 1].min(), abs=1e-6)


def every_chain(energy, need, seconds, charging, available, full, quickest):
    """The least cost over all orders of all subsets of the places between, charging at each what is needed."""
    n, best = len(energy), np.inf
    for size in range(n - 1):
        for middle in permutations(range(1, n - 1), size):
            costs = [(0.0, available)]  # (cost, left) of every way to charge so far
            chain = [0, *middle, n - 1]
            for here, there in zip(chain, chain[1:], strict=False):
                following = []
                for cost, left in costs:
                    ready = [(0.0, left)]
                    if here:
                        if charging.power_w is None:
                            ready.append((charging.stop_s, full))
                        else:
                            more = max(need[here, there] - left, 0.0)
                            ready.append((charging.stop_s + more / charging.power_w, left + more))
                    for wait, begins in ready:
                        if begins + 1e-9 >= need[here, there] and begins <= full + 1e-9:
                            own = wait + seconds[here, there] if quickest else energy[here, there]
                            following.append((cost + own, begins - energy[here, there]))
                costs = following
            best = min([best, *(cost for cost, _ in costs)])
    return best


@pytest.mark.parametrize("quickest", [False, True])
@pytest.mark.parametrize("charging", [Charging(50.0, 30.0), Charging(None, 90.0)])
@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_best_of_all_chains(seed: int, charging: Charging, quickest: bool) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 100.0, (6, 2))
    energy = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) * rng.uniform(1.0, 1.5, (6, 6))
    energy[rng.uniform(size=energy.shape) < 0.15] = np.inf
    need, seconds = 1.2 * energy, 0.7 * energy
    available, full = rng.uniform(20.0, 60.0), rng.uniform(50.0, 90.0)
    found = cheapest_chain(
        energy, need, seconds, charging, available_j=min(available, full), full_j=full, quickest=quickest
    )
    best = every_chain(energy, need, seconds, charging, min(available, full), full, quickest)
    if found is None:
        assert best == np.inf
        return
    assert (found[0].start, found[-1].goal) == (0, 5)
    ends = [(hop.start, hop.goal) for hop in found]
    assert all(hop.left_j >= need[end] - 1e-9 for hop, end in zip(found, ends, strict=True))
    took = [seconds[end] + hop.waits_s if quickest else energy[end] for hop, end in zip(found, ends, strict=True)]
    assert sum(took) == pytest.approx(best)
