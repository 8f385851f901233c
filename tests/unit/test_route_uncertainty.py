"""The standard deviation of a route's energy, and the probability of a verdict that follows from it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.battery import Battery
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route import price_route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.verdict.budget import judge
from joulemap.service.analysis.feasibility import assess
from joulemap.service.analysis.route_uncertainty import odds_along, odds_of_energies

INDEPENDENT = Spread(run_share=0.0, correlation_m=1.0)


def level(spread: Spread | None, std_j: float = 3.0) -> CostLattice:
    """40 x 40 m of level ground on which a metre costs 20 J, 3 J up or down."""
    flat = Heightmap(np.zeros((40, 40), dtype=np.float32), GridFrame(0.0, 40.0, 1.0, 40, 40))
    robot = Robot(mass_kg=20.0 / 9.80665, idle_power_w=0.0, rolling_resistance=1.0)
    lattice = build_lattice(flat, robot, PhysicsPredictor())
    provenance = {"model": {"spread": spread.as_dict()}} if spread is not None else {"model": {}}
    return replace(lattice, provenance=provenance, std_j=np.full(lattice.traction_per_m.shape, std_j, np.float32))


def test_the_std_of_independent_segments_grows_with_the_root_and_of_correlated_ones_in_proportion() -> None:
    energy, std = np.full(16, 50.0), np.full(16, 3.0)
    np.testing.assert_allclose(INDEPENDENT.route_std(energy, std), 3.0 * np.sqrt(np.arange(1, 17)))
    together = Spread(run_share=0.0, correlation_m=1e12)
    np.testing.assert_allclose(together.route_std(energy, std), 3.0 * np.arange(1, 17), rtol=1e-9)


def test_two_segments_by_hand() -> None:
    """A correlation length of 3 m is one half between neighbours, (1 + 1/2) / (1 - 1/2): 1 + 4 + 2 x 1 x 2 / 2 = 7."""
    spread = Spread(run_share=0.1, correlation_m=3.0)
    assert spread.route_std([10.0, 10.0], [1.0, 2.0])[-1] == pytest.approx(math.sqrt(2.0**2 + 7.0))


@given(
    std=st.lists(st.floats(0.0, 20.0), min_size=1, max_size=20),
    correlation_m=st.floats(1.0, 30.0),
    n=st.integers(0, 19),
)
def test_against_the_whole_covariance(std: list[float], correlation_m: float, n: int) -> None:
    spread, k = Spread(run_share=0.0, correlation_m=correlation_m), min(n, len(std) - 1)
    neighbour = (correlation_m - 1.0) / (correlation_m + 1.0)
    some = np.array(std[: k + 1])
    distance = np.abs(np.subtract.outer(np.arange(k + 1), np.arange(k + 1)))
    variance = some @ neighbour**distance @ some
    assert spread.route_std(np.zeros(len(std)), std)[k] == pytest.approx(math.sqrt(variance), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    "corners", [[(5.0, 20.0), (21.0, 20.0)], [(5.0, 20.0), (9.3, 20.0), (9.3, 26.0), (15.0, 26.0)]]
)
def test_a_route_of_16_m_is_16_segments_however_it_is_cut(corners: list[tuple[float, float]]) -> None:
    route = price_route(level(INDEPENDENT), corners)
    assert route.length_m == pytest.approx(16.0)
    odds = odds_along([route])
    assert odds is not None
    assert odds.final_std_j == pytest.approx(3.0 * 4.0, rel=1e-5)
    assert odds_along([price_route(level(None), corners)]) is None


def test_an_error_of_the_whole_run_may_grow_with_the_deviations() -> None:
    """Half of 16 and of 32 times 3 J, beside independent metres: of a route, of energies alone, and along it."""
    spread = Spread(run_share=0.0, correlation_m=1.0, run_std_share=0.5)
    lattice = level(spread)
    odds = odds_along([price_route(lattice, [(5.0, 20.0), (21.0, 20.0)])])
    assert odds is not None
    of_metres = 3.0 * np.sqrt([8.0, 16.0, 32.0])
    assert odds.final_std_j == pytest.approx(math.hypot(24.0, of_metres[1]), rel=1e-5)
    assert odds.scale_j[odds.scale_j.size // 2 - 1] == pytest.approx(math.hypot(12.0, of_metres[0]), rel=0.1)
    energies = odds_of_energies(lattice, [320.0, 640.0])
    assert energies is not None
    assert energies.scale_j == pytest.approx(np.hypot([24.0, 48.0], of_metres[1:]), rel=1e-4)
    metres = np.full(1000, 20.0), np.full(1000, 3.0)
    assert spread.widened(2.0).route_std(*metres)[-1] == pytest.approx(2.0 * spread.route_std(*metres)[-1], rel=1e-3)
    assert Spread.from_dict({k: v for k, v in spread.as_dict().items() if k != "run_std_share"}).run_std_share == 0.0


def test_the_way_back_shares_the_error_of_the_run() -> None:
    """16 m there and back at 20 J/m are 640 J, of which a tenth, and 32 independent metres of 3 J."""
    lattice = level(Spread(run_share=0.1, correlation_m=1.0))
    planner, there = RoutePlanner(lattice), [(5.0, 20.0), (21.0, 20.0)]
    verdict = assess(planner, battery=Battery(1.0), path=there, round_trip=True).verdict
    assert verdict.energy_j == pytest.approx(640.0, rel=1e-5)
    assert verdict.energy_std_j == pytest.approx(math.hypot(64.0, 3.0 * math.sqrt(32.0)), rel=1e-5)
    assert verdict.probability == 0.99  # 40 standard deviations: at least 0.99 is all that is known


def test_a_deviation_between_cells_and_headings_is_a_mean_of_its_neighbours() -> None:
    lattice = level(INDEPENDENT)
    assert lattice.std_j is not None
    rows, cols, bins = np.indices(lattice.std_j.shape).astype(np.float32)
    lattice = replace(lattice, std_j=1.0 + 0.1 * rows + 0.2 * cols + 0.5 * np.minimum(bins, 16 - bins))
    route = price_route(
        lattice, [(10.25, 20.25), (10.25, 21.0)]
    )  # north, whose bin is 0; middle at row 18.875, col 9.75
    assert route.profile.std_j is not None
    assert route.profile.std_j[0] == pytest.approx(0.75 * (1.0 + 0.1 * 18.875 + 0.2 * 9.75), rel=1e-6)
    step = 0.5 * np.array([math.sin(-math.pi / 16), math.cos(-math.pi / 16)])  # half a bin to the west of north
    tilted = price_route(lattice, [np.array([10.25, 20.25]) - step, np.array([10.25, 20.25]) + step])
    assert tilted.profile.std_j is not None
    assert tilted.profile.std_j[0] == pytest.approx(1.0 + 0.1 * 19.25 + 0.2 * 9.75 + 0.25, rel=1e-6)


def test_probabilities_of_the_normal_distribution() -> None:
    """0.8413 is the table's value one standard deviation above the mean."""
    battery = Battery(1.0)
    assert judge(3500.0, battery, std_j=100.0).probability == pytest.approx(0.8413, abs=1e-4)
    assert judge(3700.0, battery, std_j=100.0).probability == pytest.approx(0.1587, abs=1e-4)
    assert judge(3500.0, battery).probability is None


@pytest.mark.parametrize(
    ("energy_j", "std_j", "limit", "words"),
    [
        (3300.0, 100.0, 0.99, "more than 99 %"),  # three standard deviations: 0.9987
        (3900.0, 100.0, 0.01, "less than 1 %"),
        (3500.0, 0.0, 0.99, "more than 99 %"),
        (3700.0, 0.0, 0.01, "less than 1 %"),
        (3600.0, 100.0, 0.5, "50 %"),
    ],
)
def test_beyond_1_and_99_percent_no_probability_is_given(energy_j, std_j, limit, words) -> None:
    """The tails of the distribution of errors are not known: 0.99 means at least 0.99."""
    verdicts = [judge(energy_j, Battery(1.0), std_j=std_j)]
    verdicts.append(judge([energy_j, -10.0], Battery(1.0), std_j=[std_j, std_j]))  # at the lowest point
    for verdict in verdicts:
        assert verdict.probability == pytest.approx(limit)
        assert f"probability that it lasts: {words}" in str(verdict)


@pytest.mark.parametrize("bias", [0.0, 0.1])
def test_the_sentence_of_a_verdict_has_the_mean_and_no_second_number(bias: float) -> None:
    """16 m at 20 J are 0.0889 Wh, whatever the median of the distribution is: that is in `energy_p50_j`."""
    lattice = level(Spread(run_share=0.05, correlation_m=1.0, bias=bias))
    verdict = assess(RoutePlanner(lattice), battery=Battery(1.0), path=[(5.0, 20.0), (21.0, 20.0)]).verdict
    assert "expected 0.0889 Wh (90 % between " in verdict.verdict_text
    assert verdict.energy_p50_j == pytest.approx((1.0 + bias) * 320.0)


def test_with_regeneration_the_riskiest_piece_decides() -> None:
    """3500 J up are one deviation of 100 J below the battery's 3600; 1000 J come back and are no help before."""
    verdict = judge([3500.0, -1000.0], Battery(1.0), std_j=[100.0, 120.0])
    assert verdict.probability == pytest.approx(0.8413, abs=1e-4)
    assert verdict.energy_std_j == 120.0
