"""Serial correlation, spread and outliers of runs, on series whose parameters are known."""

import numpy as np
import pytest

from joulemap.model.loop._variation import Variation, fit_variation, spread_of


def _series(phi: float, share: float, rng: np.random.Generator, runs: int = 8, rows: int = 300):
    """Run numbers, predicted energies and residuals: an autoregression of `share` of the variance, and white noise."""
    run = np.repeat(np.arange(runs), rows)
    predicted = rng.uniform(50.0, 150.0, run.size)
    away = np.empty(run.size)
    for i in range(run.size):
        fresh = i % rows == 0
        step = rng.normal(0.0, 1.0)
        away[i] = step if fresh else phi * away[i - 1] + np.sqrt(1.0 - phi**2) * step
    noise = rng.normal(0.0, 1.0, run.size)
    return run, predicted, 0.05 * predicted * (np.sqrt(share) * away + np.sqrt(1.0 - share) * noise)


def _fit(run, predicted, residual) -> Variation:
    moving = np.ones(run.size, dtype=bool)
    start = Variation(run, moving, predicted, np.ones(run.size))
    return fit_variation(start, predicted, residual, np.ones((run.size, 1)))


def test_the_correlation_that_was_put_in_is_found():
    found = [_fit(*_series(np.exp(-1.0 / 10.0), 0.6, np.random.default_rng(seed))) for seed in range(5)]
    assert np.median([f.length_rows for f in found]) == pytest.approx(10.0, rel=0.4)
    assert [f.serial_share for f in found] == pytest.approx([0.6] * 5, abs=0.12)


def test_the_larger_of_two_maxima_of_the_likelihood_is_found():
    """A short correlation and a slow drift: a search that starts at the latter ends at the length of a run, 300."""
    rng = np.random.default_rng(7)
    run, predicted, brief = _series(np.exp(-1.0), 0.35, rng)
    residual = brief + 0.2 * _series(np.exp(-1.0 / 200.0), 1.0, rng)[2]
    assert _fit(run, predicted, residual).length_rows < 30.0


def test_rounding_moves_no_parameter():
    run, predicted, residual = _series(0.95, 0.3, np.random.default_rng(7))
    found, again = _fit(run, predicted, residual), _fit(run, predicted, residual * (1.0 + 1e-10 * np.cos(run)))
    assert again.length_rows == pytest.approx(found.length_rows, rel=1e-3)
    assert again.process == pytest.approx(found.process, rel=1e-3)


def test_white_noise_has_no_serial_correlation():
    found = _fit(*_series(0.0, 0.0, np.random.default_rng(2)))
    assert found.serial_share < 0.1 or found.length_rows < 1.0


def test_whitened_rows_are_not_correlated_and_equally_spread():
    run, predicted, residual = _series(0.95, 0.8, np.random.default_rng(3))
    found = _fit(run, predicted, residual)
    white = found.whitened(residual[:, None])[:, 0]
    within = np.diff(run) == 0
    assert abs(np.corrcoef(white[:-1][within], white[1:][within])[0, 1]) < 0.06
    assert abs(np.corrcoef(residual[:-1][within], residual[1:][within])[0, 1]) > 0.5
    low, high = white[predicted < 80.0].std(), white[predicted > 120.0].std()
    assert low == pytest.approx(high, rel=0.15)


def test_an_outlier_counts_less_and_moves_no_parameter():
    run, predicted, residual = _series(0.0, 0.0, np.random.default_rng(4))
    hit = residual.copy()
    hit[::20] += 60.0
    found, clean = _fit(run, predicted, hit), _fit(run, predicted, residual)
    assert found.weight[::20].max() < 0.3
    assert np.median(found.weight) == 1.0
    assert found.scale == pytest.approx(clean.scale, rel=0.2)


def test_the_spread_grows_with_the_energy():
    rng = np.random.default_rng(5)
    predicted = rng.uniform(10.0, 400.0, 4000)
    residual = rng.normal(0.0, 2.0 + 0.1 * predicted)
    spread = spread_of(predicted, residual, np.ones(4000, dtype=bool))
    assert spread == pytest.approx(2.0 + 0.1 * predicted, rel=0.2)


def test_a_sum_of_correlated_rows_has_the_variance_that_is_carried():
    rng = np.random.default_rng(6)
    run = np.repeat([0, 1], 40)
    moving = np.ones(80, dtype=bool)
    found = Variation(run, moving, np.ones(80), np.ones(80), length_rows=5.0, process=1.0)
    weight = rng.normal(size=(80, 1))
    lag = np.abs(np.subtract.outer(np.arange(80), np.arange(80)))
    correlation = np.where(run[:, None] == run[None, :], np.exp(-lag / 5.0), 0.0)
    expected = weight[:, 0] @ correlation @ weight[:, 0]
    assert weight[:, 0] @ weight[:, 0] + 2.0 * weight[:, 0] @ found.carried(weight)[:, 0] == pytest.approx(expected)
