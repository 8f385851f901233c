"""A meter that is slower than the log: its values between readings, and meters that are not slower."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.track import integral

T = np.arange(0.0, 60.0, 0.05)


def held(values, period=1.0, begins=0.0, t=T):
    """As a log writes what is read once in a period: each reading until the next."""
    rows = np.searchsorted(t, begins + period * np.floor((t - begins) / period + 1e-9), side="left")
    return values[np.clip(rows, 0, t.size - 1)]


def test_a_current_changes_evenly_between_its_readings():
    """Of a current in waves of 7 s, the charge of each metre is five times nearer to the true one."""
    true = 10.0 + 8.0 * np.sin(2.0 * np.pi * T / 7.0)
    found, count = between_readings(T, held(true))
    assert count == T.size - 60
    metres = np.arange(1.0, 57.0, 0.7)

    def error(values):
        return np.std(np.diff(integral(T, values, metres)) - np.diff(integral(T, true, metres)))

    assert error(found) < 0.2 * error(held(true))


def test_two_meters_that_are_read_one_after_the_other():
    """A tenth of a second between the readings of both sides: their sum has no step to the new reading of one side."""
    left, right = 8.0 * np.sin(2.0 * np.pi * T / 7.0), -8.0 * np.sin(2.0 * np.pi * (T - 0.1) / 7.0)
    steps = held(left) + held(right, begins=0.1)
    assert np.ptp(steps[40:-40]) > 5.0
    found, _ = between_readings(T, steps)
    assert np.ptp(found[40:-40]) < 1.0


def test_a_rest_lasts_until_its_last_reading():
    """Nothing is drawn for 20 s, then 10 A and more: the last reading of nothing is one period before the first of
    more, and not 20 s before.
    """
    true = np.where(T < 20.0, 0.0, 10.0 + 0.1 * T)
    found, _ = between_readings(T, held(true))
    assert (found[T <= 18.95] == 0.0).all()
    assert found[T.searchsorted(19.5)] == pytest.approx(6.0, abs=0.1)
    assert found[T.searchsorted(20.0)] == pytest.approx(12.0, abs=0.01)


@pytest.mark.parametrize(
    "values",
    [
        10.0 + np.sin(T),
        np.full(T.size, 3.0),
        np.round(3.0 + np.random.default_rng(0).normal(0.0, 0.3, T.size)),
        np.round(2.0 * np.cumsum(np.random.default_rng(1).normal(0.0, 0.1, T.size))),
        np.where(T < 30.0, 2.0, 5.0),
        held(np.random.default_rng(2).normal(5.0, 1.0, T.size), period=0.1),
        np.full(T.size, np.nan),
    ],
    ids=[
        "read in every row",
        "constant",
        "coarse and steady",
        "coarse and wandering",
        "a step",
        "ten a second",
        "blank",
    ],
)
def test_other_meters_are_taken_as_they_are(values):
    found, count = between_readings(T, values)
    assert count == 0
    assert found is values


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 4.0), st.floats(0.0, 0.9))
def test_readings_stay_and_nothing_is_beyond_them(seed, period, begins):
    rng = np.random.default_rng(seed)
    values = held(rng.normal(5.0, 2.0, T.size), period, begins * period)
    values[rng.random(T.size) < 0.05] = np.nan
    found, count = between_readings(T, values)
    known = np.isfinite(values)
    assert count > 0
    np.testing.assert_array_equal(np.isfinite(found), known)
    assert np.nanmin(values) - 1e-9 <= found[known].min()
    assert found[known].max() <= np.nanmax(values) + 1e-9
    rows = np.flatnonzero(known)
    fresh = rows[np.append(True, np.diff(values[rows]) != 0.0)]
    stays = np.diff(np.append(T[fresh], T[rows[-1]]))
    kept = fresh[stays >= 0.9 * period]
    np.testing.assert_allclose(found[kept], values[kept])
