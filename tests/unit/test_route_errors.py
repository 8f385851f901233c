"""How errors of held-out runs add up: offsets of runs, correlation, tails, bias and unequal sides are found again."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.model.energy.route_errors import ENOUGH, correlated_variance, fit_route_errors
from joulemap.model.energy.uncertainty import Spread, fit_spread
from joulemap.planner.verdict.energy_distribution import EnergyOdds

RUNS, LENGTH = 60, 200


def drives(*, offsets: np.ndarray, phi: float = 0.0, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Measured and predicted energy, standard deviation and run; a tenth of noise per metre, correlated by phi."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(offsets.size), LENGTH)
    predicted = rng.uniform(40.0, 120.0, run.size)
    noise = rng.standard_normal(run.size)
    for k in range(1, run.size):
        if run[k] == run[k - 1]:
            noise[k] = phi * noise[k - 1] + np.sqrt(1.0 - phi**2) * noise[k]
    return predicted * (1.0 + offsets[run]) + 0.1 * predicted * noise, predicted, 0.1 * predicted, run


def test_the_variance_of_correlated_sums_is_that_of_the_whole_covariance() -> None:
    for phi in (-0.4, 0.0, 0.6):
        correlation = (1.0 + phi) / (1.0 - phi)
        for count in (1, 2, 7, 40):
            apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
            whole = 4.0 * (phi**apart).sum()
            found = correlated_variance(np.array([4.0 * count]), np.array([float(count)]), correlation)
            assert found[0] == pytest.approx(whole)


@pytest.mark.parametrize(("share", "phi"), [(0.0, 0.0), (0.08, 0.0), (0.08, 0.6), (0.0, 0.8)])
def test_the_spread_of_sums_is_found(share: float, phi: float) -> None:
    offsets = share * np.random.default_rng(5).standard_normal(RUNS)
    measured, predicted, std, run = drives(offsets=offsets, phi=phi)
    spread = fit_spread(measured, predicted, std, run)
    more, said, *_ = drives(offsets=share * np.random.default_rng(6).standard_normal(RUNS), phi=phi, seed=1)
    sums = [(more[run == k] - said[run == k]).sum() for k in range(RUNS)]
    told = [spread.along(said[run == k], spread.factor * 0.1 * said[run == k]) for k in range(RUNS)]
    steps = np.array(sums) / np.array([scale[-1] for scale, _ in told])
    assert np.mean(np.abs(steps) < 0.69) == pytest.approx(0.5, abs=0.2)
    assert np.std(steps) == pytest.approx(1.0, abs=0.45)


def test_fat_tails_are_used_where_runs_show_them() -> None:
    rng = np.random.default_rng(2)
    heavy = fit_spread(*drives(offsets=0.05 * rng.standard_t(3, 100)))
    normal = fit_spread(*drives(offsets=0.05 * rng.standard_normal(100)))
    assert heavy.freedom is not None
    assert heavy.freedom < 8.0
    assert normal.freedom is None or normal.freedom > 12.0


def test_a_bias_and_unequal_sides_are_found_on_many_runs_only() -> None:
    rng = np.random.default_rng(3)
    size = np.abs(rng.standard_normal(200))
    offsets = 0.1 + np.where(rng.random(200) < 0.5, 0.12 * size, -0.04 * size)
    many = fit_spread(*drives(offsets=offsets))
    assert many.bias == pytest.approx(0.1, abs=0.03)
    assert many.skew == pytest.approx(3.0, rel=0.5)
    few = fit_spread(*drives(offsets=offsets[: ENOUGH - 1]))
    assert (few.bias, few.skew) == (0.0, 1.0)


def test_an_error_of_runs_that_grows_with_their_deviations_is_found_on_many_runs() -> None:
    """Runs that are known to 5 to 40 % a metre, and off by half as much as a whole: a share of the energy would be too
    wide for the well known half, and too narrow for the other."""
    rng = np.random.default_rng(4)

    def _drives() -> tuple[np.ndarray, ...]:
        run = np.repeat(np.arange(400), 100)
        predicted = rng.uniform(40.0, 120.0, run.size)
        std = np.geomspace(0.05, 0.4, 400)[run] * predicted
        of_run = 0.5 * rng.standard_normal(400)[run]
        return predicted + std * (of_run + rng.standard_normal(run.size)), predicted, std, run

    spread = fit_spread(*_drives())
    assert spread.factor * spread.run_std_share == pytest.approx(0.5, rel=0.25)
    assert spread.run_share < 0.02
    measured, predicted, std, run = _drives()
    for half in (run < 200, run >= 200):
        inside = []
        for one in np.unique(run[half]):
            mine = run == one
            scale = spread.along(predicted[mine], spread.factor * std[mine])[0][-1]
            inside.append(abs(measured[mine].sum() - predicted[mine].sum()) < 1.28 * scale)
        assert np.mean(inside) == pytest.approx(0.8, abs=0.09)
    few = run < ENOUGH - 1
    assert fit_spread(measured[few], predicted[few], std[few], run[few]).run_std_share == 0.0


def test_three_campaigns_leave_the_offset_uncertain() -> None:
    """Student's t with as many degrees of freedom as campaigns, and the campaigns count, not their runs."""
    offsets = np.repeat([-0.1, 0.02, 0.12], 5)
    measured, predicted, std, run = drives(offsets=offsets)
    spread = fit_spread(measured, predicted, std, run, group=run // 5)
    assert spread.run_freedom == 3.0
    assert spread.run_share == pytest.approx(np.sqrt(np.mean(np.square([0.1, 0.02, 0.12]))), rel=0.3)
    found = fit_route_errors(measured - predicted, predicted, std, run, run // 5)
    assert found.groups == 3


def test_errors_of_neighbours_make_up_for_each_other_on_many_runs_only() -> None:
    """Half of each error is taken back on the next metre, as by a slow meter."""
    for runs, known in ((4, False), (ENOUGH, True)):
        measured, predicted, std, run = drives(offsets=0.15 * np.random.default_rng(8).standard_normal(runs))
        own = measured - predicted * (measured.reshape(runs, -1).sum(1) / predicted.reshape(runs, -1).sum(1))[run]
        spread = fit_spread(measured - 0.5 * np.roll(own, 1), predicted, std, run)
        assert (spread.correlation_m < 0.8) == known
        assert known or (spread.correlation_m >= 1.0 and spread.run_freedom == runs - 1)


def test_the_freedom_of_a_sum_lies_between_those_of_its_parts() -> None:
    spread = Spread(run_share=0.1, freedom=30.0, run_freedom=4.0)
    _, freedom = spread.along(np.full(200, 50.0), np.full(200, 10.0))
    assert freedom is not None
    assert 4.0 < freedom[-1] < freedom[0] < 40.0
    assert Spread().along([50.0], [5.0])[1] is None


def test_quantiles_and_probabilities_are_one_distribution() -> None:
    odds = EnergyOdds(np.array([100.0]), np.array([10.0]), np.array([5.0]), bias=0.05, skew=2.0)
    for share in (0.05, 0.3, 0.5, 0.7, 0.95):
        assert odds.lasts(odds.quantile(share))[0] == pytest.approx(share)
    assert odds.quantile(0.5)[0] == pytest.approx(105.0)
    assert (odds.quantile(0.9) - 105.0)[0] == pytest.approx(2.0 * (105.0 - odds.quantile(0.1))[0])
