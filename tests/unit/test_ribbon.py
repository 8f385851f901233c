"""Ways beside a path: found where they are cheaper, over ridges that no small shift crosses, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.planner.best import best_of
from joulemap.planner.edges import leg_prices, path_price
from joulemap.planner.lattice import Blocked
from joulemap.planner.polylines import subdivided
from joulemap.planner.refine import refine_path
from joulemap.planner.ribbon import Ribbon, ways_beside
from tests.reference.lattices import ascii_lattice

ROWS, COLS, LINE = 21, 81, 10
WIDE = Ribbon(spacing=4, half_width=4.0, step=0.5, slope=1.0)


def ground(prices):
    """A flat lattice with so many times 3 J/m of traction, by row and column, beside 1 J/m of idle energy."""
    lattice = ascii_lattice("\n".join(["." * COLS] * ROWS))[0]
    traction = np.broadcast_to(3.0 * prices, (ROWS, COLS))[:, :, None]
    return replace(lattice, traction_per_m=(lattice.traction_per_m + traction).astype(np.float32))


def channel(side=3, first=20, last=60):
    """Ground that costs a third of the rest in one row beside the line, behind a ridge that costs twice as much."""
    prices = np.ones((ROWS, COLS))
    prices[LINE + side - 1, first:last] = 2.0
    prices[LINE + side, first:last] = 1.0 / 3.0
    return ground(prices)


def straight():
    return subdivided(np.array([(LINE, 4.0), (LINE, 76.0)]), 0.5)


def test_even_ground_has_no_way_beside():
    assert ways_beside(ground(np.ones(1)), straight(), WIDE) == []
    assert ways_beside(ground(np.ones(1)), straight()[:4], WIDE) == []


@pytest.mark.parametrize("side", [-3, 3])
def test_a_cheap_channel_behind_a_ridge_is_found_and_shifts_alone_do_not_find_it(side):
    lattice, path = channel(side), straight()
    ((first, last, way),) = ways_beside(lattice, path, WIDE)
    np.testing.assert_array_equal(way[[0, -1]], path[[first, last]])
    assert np.median(way[:, 0]) == LINE + side
    usual = path_price(lattice, path)
    assert path_price(lattice, way) < path_price(lattice, path[first : last + 1])
    shifted = path_price(lattice, refine_path(lattice, path))
    assert shifted <= usual
    assert path_price(lattice, best_of(lattice, [path])) < 0.9 * shifted


def test_two_channels_are_two_ways():
    prices = np.ones((ROWS, COLS))
    prices[LINE + 2, 12:30] = prices[LINE - 2, 50:68] = 0.3
    ways = ways_beside(ground(prices), straight(), WIDE)
    assert [np.sign(np.median(way[:, 0]) - LINE) for _, _, way in ways] == [1, -1]


def test_a_dearer_valley_is_a_way_within_the_slack():
    prices = np.ones((ROWS, COLS))
    prices[LINE + 3, 20:60], prices[LINE - 3, 20:60] = 0.3, 0.4
    lattice, path = ground(prices), straight()

    def _saved_j(first, last, way):
        return path_price(lattice, path[first : last + 1]) - path_price(lattice, way)

    (best,) = ways_beside(lattice, path, WIDE)
    assert np.median(best[2][:, 0]) == LINE + 3
    dearer_j = 0.1 * 3.0 * 40.0  # 3 J/m of traction over 40 m
    assert len(ways_beside(lattice, path, WIDE, slack_j=0.5 * dearer_j)) == 1
    ways = ways_beside(lattice, path, WIDE, slack_j=1.5 * dearer_j)
    (other,) = [way for way in ways if np.median(way[2][:, 0]) < LINE]
    assert np.median(other[2][:, 0]) == LINE - 3
    np.testing.assert_array_equal(ways[0][2], best[2])
    assert _saved_j(*best) - _saved_j(*other) == pytest.approx(dearer_j, rel=0.1)


def test_no_way_leads_over_blocked_ground():
    lattice = channel()
    blocked = lattice.blocked.copy()
    blocked[LINE + 1 :, 38:42] = int(Blocked.UNKNOWN)
    closed = replace(lattice, blocked=blocked)
    for ribbon in (WIDE, replace(WIDE, step=0.25)):
        ways = ways_beside(closed, straight(), ribbon)
        assert len(ways) == 2
        assert all(np.isfinite(leg_prices(closed, way)).all() for _, _, way in ways)
    blocked[:, 40] = int(Blocked.UNKNOWN)
    assert ways_beside(replace(lattice, blocked=blocked), straight(), WIDE) == []
