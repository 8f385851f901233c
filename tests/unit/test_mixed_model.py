"""Tests, left-out errors and intervals of the mixed model, against slow reference computations."""

import numpy as np
import pytest
from scipy.stats import linregress, t
from statsmodels.regression.mixed_linear_model import MixedLM

from joulemap.model.loop._mixed_model import MixedModel
from joulemap.model.loop._variation import Variation

NONE = np.zeros(0, dtype=np.int64)
FIRST, SECOND = np.array([0]), np.array([1])


def _model(columns, residual, run, level=None) -> MixedModel:
    moving = np.ones(run.size, dtype=bool)
    variation = Variation(run, moving, np.ones(run.size), np.ones(run.size))
    level = np.ones(run.size) if level is None else level
    return MixedModel(variation, columns, residual, level, run, np.ones(columns.shape[1]), whole_runs=True)


def _data(rng, runs=6, rows=80):
    run = np.repeat(np.arange(runs), rows)
    return run, rng.normal(size=(run.size, 2)), rng.normal(size=run.size)


def test_levels_of_runs_do_not_touch_a_test_inside_runs():
    run, x, z = _data(np.random.default_rng(1))
    offsets = np.random.default_rng(2).normal(0.0, 5.0, 6)[run]
    plain = _model(x, z, run).test_within(FIRST, SECOND)
    moved = _model(x, z + offsets, run).test_within(FIRST, SECOND)
    assert moved == pytest.approx(plain, rel=1e-6)


def test_p_values_inside_runs_are_uniform_where_nothing_is():
    rng = np.random.default_rng(3)
    p_values = []
    for _ in range(300):
        run, x, z = _data(rng, runs=4, rows=40)
        p_values.append(_model(x, z * (1.0 + 2.0 * (x[:, 0] > 1.0)), run).test_within(FIRST, SECOND))
    assert 0.02 <= np.mean(np.array(p_values) < 0.05) <= 0.08


def test_p_values_between_few_runs_are_no_smaller_than_they_should_be():
    rng = np.random.default_rng(4)
    p_values = []
    for _ in range(300):
        run, _, z = _data(rng, runs=6, rows=30)
        x = np.column_stack([rng.normal(size=6)[run], rng.normal(size=run.size)])
        p_values.append(_model(x, z + rng.normal(0.0, 3.0, 6)[run], run).test_between(FIRST, SECOND, NONE))
    assert 0.02 <= np.mean(np.array(p_values) < 0.05) <= 0.08


def test_a_difference_between_runs_is_tested_like_a_line_through_their_levels():
    rng = np.random.default_rng(5)
    run = np.repeat(np.arange(8), 500)
    warm = rng.normal(size=8)
    offsets = 0.5 * warm + rng.normal(0.0, 1.0, 8)
    z = offsets[run] + rng.normal(0.0, 0.01, run.size)
    found = _model(np.column_stack([warm[run], rng.normal(size=run.size)]), z, run).test_between(FIRST, NONE, NONE)
    assert found == pytest.approx(linregress(warm, offsets).pvalue, rel=0.05)


def test_the_variance_between_units_is_that_of_statsmodels():
    """Restricted maximum likelihood of a random intercept, with a column that differs between units only."""
    rng = np.random.default_rng(11)
    run, x, z = _data(rng, runs=12, rows=40)
    x = np.column_stack([np.ones(run.size), rng.normal(size=12)[run], x[:, 0]])
    z = z + x @ [2.0, 1.5, -0.5] + rng.normal(0.0, 0.7, 12)[run]
    model, every = _model(x, z, run, level=np.full(run.size, 20.0)), np.arange(3)  # levels of some percent
    theirs = MixedLM(z, x, run).fit(reml=True)
    assert 20.0**2 * model.tau2(every) == pytest.approx(theirs.cov_re[0, 0] / theirs.scale, rel=0.05)
    limits = np.full(3, np.inf)
    ours = model.estimate(every, -limits, limits, NONE).coefficients
    np.testing.assert_allclose(ours, theirs.fe_params, rtol=0.02, atol=0.01)


def test_what_a_column_explains_is_no_variation_between_units():
    rng = np.random.default_rng(12)
    run, x, z = _data(rng, runs=8)
    levels = rng.normal(0.0, 3.0, 8)
    x[:, 0] = levels[run]
    model = _model(x, z + levels[run], run, level=np.full(run.size, 100.0))
    assert 100.0**2 * model.tau2(SECOND) == pytest.approx(np.var(levels, ddof=1), rel=0.4)
    assert 100.0**2 * model.tau2(np.array([0, 1])) < 0.05


def test_a_flat_likelihood_invents_no_runs_that_differ_several_times():
    """Four short runs whose energy is three times its prediction: that is an error of the prediction."""
    rng = np.random.default_rng(13)
    run, _, _ = _data(rng, runs=4, rows=12)
    level = 100.0 * rng.uniform(0.5, 1.5, run.size)
    model = _model(level[:, None], 3.0 * level * (1.0 + rng.normal(0.0, 0.3, run.size)), run, level=level)
    assert np.sqrt(model.tau2(FIRST) * model.sigma2(FIRST)) < 0.5
    wide = np.array([np.inf])
    assert model.estimate(FIRST, -wide, wide, NONE).coefficients[0] == pytest.approx(3.0, rel=0.15)


def test_a_column_that_is_constant_in_runs_has_no_test_inside_them():
    run, x, z = _data(np.random.default_rng(6))
    x[:, 0] = np.arange(6)[run]
    assert _model(x, z, run).test_within(FIRST, SECOND) == 1.0


def test_left_out_errors_are_those_of_fits_without_the_unit():
    run, x, z = _data(np.random.default_rng(7))
    model = _model(x, z + 2.0 * x[:, 0], run)
    errors = model.left_out(np.array([0, 1]), 0.0)
    scaled = x / model.size
    target = z + 2.0 * x[:, 0]
    for unit in range(6):
        rest, out = run != unit, run == unit
        gram = scaled[rest].T @ scaled[rest]
        prior = np.diag(np.mean(scaled**2, axis=0))  # worth one row of all
        beta = np.linalg.solve(gram + prior, scaled[rest].T @ target[rest])
        assert errors[unit] == pytest.approx(np.sum((target[out] - scaled[out] @ beta) ** 2))


def test_intervals_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(8)
    covered = []
    for _ in range(200):
        run, x, z = _data(rng, runs=6, rows=40)
        z = z + 1.5 * x[:, 0] + rng.normal(0.0, 0.3, 6)[run]
        estimate = _model(x, z, run).estimate(np.array([0, 1]), np.full(2, -np.inf), np.full(2, np.inf), NONE)
        low, high = estimate.interval()
        covered.append(low[0] <= 1.5 <= high[0])
    assert 0.90 <= np.mean(covered) <= 0.99


def test_intervals_cover_a_coefficient_that_differs_from_run_to_run():
    """A factor on all that a run takes changes its effects too; rows of one run do not tell by how much."""
    rng = np.random.default_rng(15)
    covered = []
    for _ in range(200):
        run, x, z = _data(rng, runs=8, rows=60)
        slopes = rng.normal(1.5, 0.3, 8)
        estimate = _model(x, z + slopes[run] * x[:, 0], run).estimate(
            np.array([0, 1]), np.full(2, -np.inf), np.full(2, np.inf), NONE
        )
        low, high = estimate.interval()
        covered.append(low[0] <= 1.5 <= high[0])
    assert 0.90 <= np.mean(covered) <= 0.99


def test_an_interval_of_equal_runs_is_that_of_their_own_estimates():
    """Of a coefficient that each run says as well as any other: Student's interval of the mean of the runs."""
    rng = np.random.default_rng(16)
    x = np.tile(rng.normal(size=200), 6)
    run, slopes = np.repeat(np.arange(6), 200), rng.normal(2.0, 0.5, 6)
    wide = np.array([np.inf])
    low, high = _model(x[:, None], slopes[run] * x, run).estimate(FIRST, -wide, wide, NONE).interval()
    own = t.interval(0.95, 5, slopes.mean(), slopes.std(ddof=1) / np.sqrt(6))
    np.testing.assert_allclose([low[0], high[0]], own, rtol=0.01)


def test_runs_differ_no_more_beside_an_effect_than_without_it():
    """Inside the later runs the energy follows a part of a column; the rest of the column, as large as the energy
    itself, could be hidden behind levels of these runs. Predictions of new runs have no levels.
    """
    rng = np.random.default_rng(17)
    run, later = np.repeat(np.arange(10), 60), np.repeat([0.0, 1.0], 300)
    level, part = rng.uniform(50.0, 150.0, run.size), rng.normal(0.0, 5.0, run.size)
    columns = np.column_stack([rng.normal(size=run.size), later * (level + part)])
    model = _model(columns, later * part + rng.normal(size=run.size), run, level=level)
    both, wide = np.array([0, 1]), np.full(2, np.inf)
    assert model.coefficients(both, -wide, wide)[1] == pytest.approx(1.0, abs=0.1)
    assert model.estimate(both, -wide, wide, FIRST).coefficients[1] == pytest.approx(0.0, abs=0.1)


def test_an_estimate_stays_within_its_physical_limits():
    run, x, z = _data(np.random.default_rng(9))
    model = _model(x, z - 3.0 * x[:, 0], run)
    estimate = model.estimate(np.array([0, 1]), np.array([0.0, -np.inf]), np.full(2, np.inf), NONE)
    assert estimate.coefficients[0] == 0.0  # and no rounding beyond: a report would say it
    free = model.estimate(np.array([0, 1]), np.full(2, -np.inf), np.full(2, np.inf), NONE)
    assert free.coefficients[0] == pytest.approx(-3.0, abs=0.2)


def test_a_column_that_one_run_shows_is_not_guessed_for_it_from_the_others():
    """Such as the one descent of all runs: the others hold next to nothing of it, and the prior is that of all rows."""
    run, x, z = _data(np.random.default_rng(14))
    x[:, 0] = 1e-3 * np.abs(x[:, 0])
    x[run == 0, 0] *= 1e4
    model = _model(x, z, run)
    with_it, without = model.left_out(np.array([0, 1]), 0.0), model.left_out(SECOND, 0.0)
    assert with_it[0] < 1.5 * without[0]


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_classes_are_pooled_as_statsmodels_predicts_random_effects(spread):
    """Eight classes, one of them in ten rows of 700; the first has no column, and is one of them all the same."""
    rng = np.random.default_rng(17)
    number = np.append(np.repeat(np.arange(7), 100), np.full(10, 7))
    z = 2.0 + rng.normal(0.0, spread, 8)[number] + rng.normal(size=number.size)
    columns = np.column_stack([np.ones(number.size), *(number == k for k in range(1, 8))]).astype(float)
    run = np.zeros(number.size, dtype=np.int64)
    variation = Variation(run, np.ones(run.size, dtype=bool), np.ones(run.size), np.ones(run.size))
    alone = MixedModel(variation, columns, z, np.ones(run.size), run, np.full(8, 1e-9), whole_runs=True)
    every, limits = np.arange(8), np.full(8, np.inf)
    pooled = alone.pooled([every[1:]], every, every[:1]).estimate(every, -limits, limits, every[:1]).coefficients
    theirs = MixedLM(z, np.ones((number.size, 1)), number).fit(reml=True)
    expected = [theirs.fe_params[0] + theirs.random_effects[k].iloc[0] for k in range(8)]
    np.testing.assert_allclose(pooled[0] + np.append(0.0, pooled[1:]), expected, atol=0.03)
    free = z[number == 7].mean()
    assert abs(pooled[0] + pooled[7] - np.mean(expected)) < abs(free - np.mean(expected))
