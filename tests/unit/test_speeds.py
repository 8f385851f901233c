"""The cheapest speed of a route against its closed form, and the speeds that a model knows."""

from __future__ import annotations

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.energy.calibrated import CalibratedPredictor
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import InputError
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.speed import Speed
from joulemap.model.loop.terms import Term
from joulemap.planner.lattice.build import build_lattice
from joulemap.service.library.costmaps import CostMap
from joulemap.service.models import find_predictor
from joulemap.service.speeds import known_speeds, speeds_along

DRAG = 6.0  # J/m per (m/s)^2
PLAIN = jm.heightmap(np.zeros((40, 60), np.float32), resolution_m=0.5)


def with_drag(low: float, high: float) -> CalibratedPredictor:
    term = Term(Speed(2), (DRAG,))
    correction = Correction((term,), (term,), ranges={"speed": (low, high)})
    return CalibratedPredictor(PhysicsPredictor(), correction, name="drag", version="1")


def test_the_cheapest_speed_is_where_idle_power_and_drag_balance() -> None:
    """E/m = P / v + m g mu + a v^2 is least where v^3 = P / 2a: 1 m/s for 12 W and 6 J/m per (m/s)^2."""
    model = with_drag(0.4, 2.0)
    costs = CostMap(build_lattice(PLAIN, jm.Robot(), model))
    route = costs.plan((3.0, 10.0), (27.0, 10.0)).route
    found = speeds_along(route, costs.lattice, PLAIN, model)
    assert found.cheapest.speed_mps == pytest.approx(1.0, abs=0.02)
    assert found.cheapest.energy_j == pytest.approx(24.0 * (12.0 + 35.0 * 9.80665 * 0.08 + 6.0), rel=1e-4)
    assert found.at_border is None
    assert found.declared is not None
    assert found.declared.energy_j == pytest.approx(route.energy_j, rel=1e-5)
    assert (found.curve[0].speed_mps, found.curve[-1].speed_mps) == (0.4, 2.0)
    assert found.curve[0].duration_s == pytest.approx(24.0 / 0.4)
    assert "cheapest at 1.00 m/s" in str(found)


def test_no_speed_is_tried_that_the_runs_did_not_have() -> None:
    model = with_drag(0.5, 0.8)
    costs = CostMap(build_lattice(PLAIN, jm.Robot(speed_mps=1.2), model))
    route = costs.plan((3.0, 10.0), (27.0, 10.0)).route
    found = speeds_along(route, costs.lattice, PLAIN, model)
    assert found.at_border == "fastest"
    assert found.cheapest.speed_mps == 0.8
    assert found.declared is None
    with pytest.raises(InputError, match=r"one speed only, 0\.5 m/s"):
        known_speeds(with_drag(0.49, 0.5), jm.Robot())
    with pytest.raises(InputError, match="does not know what speed costs"):
        known_speeds(PhysicsPredictor(), jm.Robot())
    low, high, _ = known_speeds(find_predictor("default"), jm.Robot())
    assert (low, high) == pytest.approx((0.3, 1.2), abs=0.01)
    other = jm.heightmap(np.ones((40, 60), np.float32), resolution_m=0.5)
    with pytest.raises(InputError, match="not the heightmap"):
        speeds_along(route, costs.lattice, other, model)
