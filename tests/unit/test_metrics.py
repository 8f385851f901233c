"""The mean relative error is one number: the paper's equation 3 in training, evaluation, calibration and baselines."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.model.energy.metrics import LEAST_J, errors_of, mean_relative_error, relative_errors
from joulemap.model.training.evaluation import errors
from tests.reference.drives import even, measured_on


def test_by_hand() -> None:
    # |12 - 10| / 10 = 0.2, |9 - 10| / 10 = 0.1
    assert mean_relative_error([12.0, 9.0], [10.0, 10.0]) == pytest.approx(0.15)


def test_a_small_energy_counts_as_it_is_and_none_at_all_as_a_joule() -> None:
    np.testing.assert_allclose(relative_errors([4.0, 5.0, 2.0], [2.0, 0.0, -2.0]), [1.0, 5.0 / LEAST_J, 2.0])


def test_evaluation_and_calibration_mean_the_same() -> None:
    """Energies down to a hundredth of the median: the smallest decide an equation 3 without a floor."""
    rng = np.random.default_rng(0)
    energy = np.exp(rng.uniform(np.log(2.0), np.log(200.0), 500))
    predicted = energy + rng.normal(0.0, 10.0, 500)
    expected = float(np.mean(np.abs(predicted - energy) / energy))

    rows = even(500)
    assert errors_of(measured_on(rows, energy), predicted)["mean_relative"] == pytest.approx(expected)
    assert errors(predicted, energy, rows.run)["mean_relative_error"] == pytest.approx(expected)
