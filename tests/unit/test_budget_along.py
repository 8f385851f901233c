"""Verdicts along a route: with regeneration the battery must last at its lowest point, and a full one takes no more."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.battery import Battery
from joulemap.planner.verdict.budget import judge, judge_along

PIECES = st.lists(st.floats(-5000.0, 5000.0), min_size=1, max_size=30)


def test_a_summit_that_is_out_of_reach() -> None:
    """1 Wh = 3600 J: 4000 J up and 1000 J back cost 3000 J in all, but the battery is empty before the summit."""
    verdict = judge_along([4000.0, -1000.0], Battery(1.0))
    assert judge(3000.0, Battery(1.0)).feasible
    assert (verdict.feasible, verdict.energy_j, verdict.shortfall_j) == (False, 3000.0, 400.0)


def test_a_full_battery_takes_no_more() -> None:
    verdict = judge_along([-1000.0, 3000.0], Battery(1.0))
    assert (verdict.margin_j, verdict.charge_at_end) == (600.0, pytest.approx(600.0 / 3600.0))


@given(pieces=PIECES, charge=st.floats(0.0, 1.0), reserve=st.floats(0.0, 1.0))
def test_against_a_plain_walk(pieces: list[float], charge: float, reserve: float) -> None:
    battery = Battery(2.0, charge=charge, reserve=reserve)
    verdict = judge_along(pieces, battery)
    left = lowest = battery.available_j
    for piece in pieces:
        left = min(left - piece, (1.0 - reserve) * 7200.0)
        lowest = min(lowest, left)
    assert verdict.margin_j - verdict.shortfall_j == pytest.approx(lowest, abs=1e-6)
    assert verdict.energy_j == pytest.approx(float(np.sum(pieces)))


@given(pieces=st.lists(st.floats(0.0, 5000.0), min_size=1, max_size=30))
def test_without_regeneration_it_is_the_sum(pieces: list[float]) -> None:
    assert judge_along(pieces, Battery(1.0)) == judge(float(np.sum(pieces)), Battery(1.0))
