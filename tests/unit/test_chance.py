"""p-values between runs: those of known tests where there is one, and no more false discoveries than stated."""

import numpy as np
import pytest
from scipy.stats import linregress, norm

from joulemap.model.loop.chance import SHIFTS, between_runs

_ERROR = 3.0 * np.sqrt(0.25 / SHIFTS)  # of a share of so many draws, at most


def levels_with(rng, slope, *, runs=6, usual=0.02):
    warm = np.sort(rng.uniform(-1.0, 1.0, runs))
    return warm, slope * warm + usual * rng.standard_normal(runs)


@pytest.mark.parametrize("slope", [0.0, 0.01, 0.03])
def test_one_straight_line_has_the_p_of_a_regression(slope):
    warm, levels = levels_with(np.random.default_rng(3), slope)
    p_value = between_runs(levels, {0: warm[:, None]}, usual=0.02, freedom=0)[0]
    assert p_value == pytest.approx(linregress(warm, levels).pvalue, abs=_ERROR)


def test_a_level_that_is_known_well_makes_it_a_test_with_known_variance():
    """Two-sided z of the slope; six runs of their own say little beside a thousand degrees of freedom."""
    warm, levels = levels_with(np.random.default_rng(4), 0.02)
    fitted = linregress(warm, levels)
    z = fitted.slope * np.sqrt(((warm - warm.mean()) ** 2).sum()) / 0.02
    p_value = between_runs(levels, {0: warm[:, None]}, usual=0.02, freedom=1000)[0]
    assert p_value == pytest.approx(2.0 * norm.sf(abs(z)), abs=_ERROR)
    assert p_value < fitted.pvalue


def test_near_copies_cost_nothing_and_other_columns_do():
    rng = np.random.default_rng(5)
    warm, levels = levels_with(rng, 0.04)
    alone = between_runs(levels, {0: warm[:, None]}, usual=0.02, freedom=5)[0]
    copies = between_runs(levels, {k: (3.0 + 0.5 * k * warm)[:, None] for k in range(1, 9)}, usual=0.02, freedom=5)
    others = {k: rng.standard_normal((6, 1)) for k in range(1, 9)}
    assert copies[1] == pytest.approx(alone, abs=1e-12)
    assert between_runs(levels, {0: warm[:, None]} | others, usual=0.02, freedom=5)[0] > 2.0 * alone


def test_chance_is_told_from_an_effect_as_often_as_stated():
    """Of 400 days on which runs differ as usual, one in twenty shows something at p <= 0.05, whatever is tried."""
    rng = np.random.default_rng(6)
    finds = 0
    for day in range(400):
        tried = {k: rng.standard_normal((6, 1 + k % 2)) for k in range(6)}
        p_values = between_runs(0.02 * rng.standard_normal(6), tried, usual=0.02, freedom=5, seed=day)
        finds += min(p_values.values()) <= 0.05
    assert 8 <= finds <= 33  # binomial: 20 +- 3 standard deviations


def test_what_needs_more_runs_than_there_are_is_left_out():
    rng = np.random.default_rng(7)
    tried = {
        1: rng.standard_normal((6, 1)),
        2: rng.standard_normal((6, 2)),
        3: rng.standard_normal((6, 3)),
        4: np.ones((6, 1)),
    }
    assert set(between_runs(rng.standard_normal(6), tried, usual=0.02, freedom=5)) == {1, 2}
    assert set(between_runs(rng.standard_normal(6), tried, usual=0.02, freedom=5, taken=1)) == {1}
