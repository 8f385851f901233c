"""The cheapest speed of a route against its closed form, and the speeds that a model knows."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import InputError
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.speed import Speed
from joulemap.model.loop.terms import Term
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.objectives.speed_profile import speed_profile
from joulemap.service.analysis.speeds import known_speeds, speeds_along
from joulemap.service.library.costmaps import CostMap
from joulemap.service.models import find_predictor

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


def test_on_even_ground_every_stretch_has_the_cheapest_speed_that_meets_the_deadline() -> None:
    model = with_drag(0.4, 1.8)
    costs = CostMap(build_lattice(PLAIN, jm.Robot(), model))
    route = costs.plan((3.0, 10.0), (27.0, 10.0)).route
    free = speeds_along(route, costs.lattice, PLAIN, model, by_stretch=True).profile
    assert free is not None
    assert free.until_m == pytest.approx((24.0,))
    assert free.speed_mps == pytest.approx((1.0,))
    assert free.energy_j == pytest.approx(24.0 * (12.0 + 35.0 * 9.80665 * 0.08 + 6.0), rel=1e-4)
    hurried = speeds_along(route, costs.lattice, PLAIN, model, deadline_s=18.0).profile
    assert hurried is not None
    assert 17.0 < hurried.duration_s <= 18.0
    v = 24.0 / 18.0  # at one speed, which is the best: the cost of a metre is convex
    best = 24.0 * (12.0 / v + 35.0 * 9.80665 * 0.08 + DRAG * v**2)
    assert best < hurried.energy_j < 1.03 * best
    with pytest.raises(InputError, match=r"deadline of 10 s is shorter than 13\.3 s"):
        speeds_along(route, costs.lattice, PLAIN, model, deadline_s=10.0)


@pytest.mark.parametrize("regeneration", [0.0, 0.4])
def test_no_other_choice_of_speeds_costs_less(regeneration: float) -> None:
    robot, speeds, rng = jm.Robot(regeneration=regeneration), np.array([0.4, 0.9, 1.7]), np.random.default_rng(3)
    length = np.full(20, 1.0)
    down_and_up = np.repeat([20.0, -80.0, 90.0, 20.0], 5) + rng.normal(0.0, 5.0, 20)
    traction = down_and_up + DRAG * speeds[:, None] ** 2

    def energy(chosen: tuple[int, ...]) -> float:
        total, kinetic = 0.0, 0.5 * robot.mass_kg * speeds**2
        for k, now in enumerate(chosen):
            change = kinetic[now] - kinetic[chosen[max(k - 1, 0)]]
            here = replace(robot, speed_mps=float(speeds[now]))
            total += float(here.price_per_m(traction[now, 5 * k : 5 * k + 5] + change / 5.0).sum())
        return total + float(kinetic[chosen[0]] - kinetic[chosen[-1]])

    every = {chosen: energy(chosen) for chosen in product(range(3), repeat=4)}
    free = speed_profile(traction, length, speeds, robot)
    assert free.energy_j == pytest.approx(min(every.values()))
    assert len(free.speed_mps) > 1
    times = {chosen: sum(5.0 / speeds[k] for k in chosen) for chosen in every}
    deadline = 0.5 * (free.duration_s + 20.0 / 1.7)
    hurried = speed_profile(traction, length, speeds, robot, deadline_s=deadline)
    assert hurried.duration_s <= deadline
    rivals = [e for chosen, e in every.items() if times[chosen] <= hurried.duration_s + 1e-9]
    assert hurried.energy_j == pytest.approx(min(rivals))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"deadline_s": float("nan")}, "finite number"),
        ({"deadline_s": -5.0}, "greater than 0"),
        ({"route": []}, "path"),
    ],
)
def test_values_are_checked_as_over_http(given: dict[str, object], said: str) -> None:
    costs = CostMap(build_lattice(PLAIN, jm.Robot(), with_drag(0.4, 1.8)))
    values = {"route": [(3.0, 10.0), (27.0, 10.0)], **given}
    with pytest.raises(InputError, match=said):
        costs.speeds(values.pop("route"), PLAIN, **values)
