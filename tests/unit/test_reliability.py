"""Odds are checked on runs that had no part in them, widened where they are too narrow, and told with the report."""

import numpy as np
import pytest

from joulemap.model.energy.reliability import _widened, checked_spread


def held(seed, *, run_sd=0.05, runs=24, each=160):
    """Segments of runs whose level differs by `run_sd`, with 10 % of noise."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), each)
    predicted = rng.uniform(40.0, 60.0, run.size)
    levels = 1.0 + run_sd * rng.standard_normal(runs)
    energy = predicted * levels[run] + 5.0 * rng.standard_normal(run.size)
    return energy, predicted, np.full(run.size, 5.0), run


def test_odds_of_runs_that_are_alike_in_kind_are_right_and_stay_as_they_are():
    energy, predicted, std, run = held(1)
    spread, check = checked_spread(energy, predicted, std, run, run)
    told = check.as_dict()
    assert told["factor"] == 1.0
    assert told["routes"] == 24 * (8 + 4 + 2 + 1)
    assert told["inside"]["80"] == pytest.approx(0.8, abs=0.1)
    assert dict(map(tuple, told["curve"]))[0.5] == pytest.approx(0.5, abs=0.15)
    assert spread.run_share == pytest.approx(0.05, abs=0.02)


def test_odds_that_are_too_narrow_are_made_as_wide_as_they_must_be():
    """Errors are 1.5 times as large as was said: a tail of p is one of Phi(1.5 z)."""
    from scipy.special import ndtr

    rng = np.random.default_rng(2)
    group = np.repeat(np.arange(30), 20)
    right, wide = (ndtr(size * rng.standard_normal(group.size)) for size in (1.0, 1.5))
    assert _widened(right, group) == 1.0
    assert _widened(wide, group) == pytest.approx(1.5, abs=0.15)


def test_two_groups_are_too_few_for_a_check():
    energy, predicted, std, run = held(3, runs=2)
    assert checked_spread(energy, predicted, std, run, run)[1] is None


def test_runs_with_names_beside_each_other_are_not_left_out_together():
    """The first two of twenty runs lie on dearer ground: a spread that knows neither calls them all but impossible."""
    energy, predicted, std, run = held(4, run_sd=0.02, runs=20)
    check = checked_spread(np.where(run < 2, 1.3 * energy, energy), predicted, std, run, run)[1]
    assert np.all(1.0 - check.below[check.group < 2] > 1e-6)
