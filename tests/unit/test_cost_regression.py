"""The regression of turning, time and speeding up: it finds what was put in, keeps its bounds, resists outliers."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.training.cost_regression import CostRows, fit_costs

ROBOT = Robot(mass_kg=60.0, speed_mps=0.5, idle_power_w=15.0, rolling_resistance=0.08)
COSTS = DriveCosts(turn_j_per_rad=50.0, driving_w=20.0, speed_up_kg=70.0, mass_kg=60.0)


def drives(count: int, *, seed: int = 0, runs: int = 4) -> Segments:
    """Segments of drives that turn at all rates, at 0.2 to 0.8 m/s."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.2, 0.8, count)
    duration = 1.0 / speed
    turned = np.where(rng.random(count) < 0.6, rng.uniform(0.0, 1.2, count), 0.0)
    nan = np.full(count, np.nan)
    return Segments(
        x=nan,
        y=nan,
        heading_rad=np.zeros(count),
        energy_j=np.zeros(count),
        duration_s=duration,
        driven_m=np.ones(count),
        heading_change_rad=turned,
        turned_abs_rad=turned,
        gained_m2ps2=rng.exponential(0.1, count),
        kinetic_m2ps2=np.zeros(count),
        standing_s=np.zeros(count),
        voltage_v=np.full(count, 28.8),
        current_a=np.ones(count),
        ripple=np.ones(count),
        t0=np.arange(count, dtype=float),
        run=np.arange(count) * runs // count,
        runs=tuple(f"{k}.csv" for k in range(runs)),
    )


def rows_of(segments: Segments, *, costs: DriveCosts = COSTS, mu: float = 0.08, noise: float = 0.05, seed: int = 1):
    """What the robot draws with these costs on ground of resistance `mu`, where 0.08 is declared."""
    rng = np.random.default_rng(seed)
    grade = rng.normal(0.0, 0.05, len(segments))
    energy = ROBOT.price_per_m(ROBOT.weight_n * (mu + grade)) + costs.energy_j(ROBOT, segments)
    energy = energy * (1.0 + noise * rng.standard_normal(len(segments)))
    traction = ROBOT.weight_n * (ROBOT.rolling_resistance + grade)
    return CostRows(
        replace(segments, energy_j=energy),
        (ROBOT,),
        np.zeros(len(segments), dtype=np.int64),
        traction,
        np.zeros(len(segments)),
        grade,
    )


def test_what_was_put_in_is_found_with_another_rolling_resistance_than_declared():
    fit = fit_costs(rows_of(drives(3000), mu=0.13))
    assert fit.costs.planned_turn_j_per_rad(ROBOT) == pytest.approx(50.0, rel=0.06)
    assert fit.costs.driving_w == pytest.approx(20.0, rel=0.1)
    assert fit.costs.speed_up_kg == pytest.approx(70.0, rel=0.15)
    assert fit.level == pytest.approx(0.05, abs=0.004)


def test_what_costs_nothing_stays_within_bounds():
    truth = DriveCosts(turn_j_per_rad=-30.0, driving_w=0.0, speed_up_kg=-40.0, mass_kg=60.0)
    fit = fit_costs(rows_of(drives(1500), costs=truth))
    assert fit.costs.turn_j_per_rad >= 0.0
    assert fit.costs.planned_turn_j_per_rad(ROBOT) < 2.0
    assert 0.0 <= fit.costs.speed_up_kg < 2.0


def test_one_metre_in_thirty_that_is_wrong_moves_little():
    rows = rows_of(drives(1500))
    energy = rows.segments.energy_j.copy()
    energy[::30] *= 8.0
    spoiled = CostRows(
        replace(rows.segments, energy_j=energy),
        rows.robots,
        rows.robot,
        rows.traction_per_m,
        rows.shape_per_m,
        rows.tan_grade,
    )
    clean, moved = (fit_costs(one).costs for one in (rows, spoiled))
    assert moved.planned_turn_j_per_rad(ROBOT) == pytest.approx(clean.planned_turn_j_per_rad(ROBOT), rel=0.1)
    assert moved.driving_w == pytest.approx(clean.driving_w, rel=0.25)


def test_a_robot_of_twice_the_mass_pays_twice_for_turning():
    heavy = Robot(mass_kg=120.0)
    segments = drives(10)
    straight = DriveCosts(turn_j_per_rad=50.0, speed_up_kg=70.0, mass_kg=60.0)
    np.testing.assert_allclose(straight.energy_j(heavy, segments), 2.0 * straight.energy_j(ROBOT, segments))
    assert straight.planned_turn_j_per_rad(heavy) == 100.0


def test_costs_come_back_from_a_file_and_nonsense_does_not():
    costs = DriveCosts(turn_j_per_rad=3.0, driving_w=None)
    assert DriveCosts.from_dict(costs.as_dict()) == costs
    for values in (
        {"eased_turn_j_per_rad": 1.0},
        {"turning": 1.0},
        {"turn_j_per_rad": float("nan")},
        {"speed_up_kg": "much"},
    ):
        with pytest.raises(ModelError):
            DriveCosts.from_dict(values)
