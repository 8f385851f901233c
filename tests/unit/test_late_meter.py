"""What a late meter says: of power that changes, at stops, and where rows are missing."""

import numpy as np
import pytest

from joulemap.model.runs.features import concatenate_features
from joulemap.model.runs.late_meter import read_late
from tests.reference.drives import ROBOT, even


def test_a_late_meter_says_what_was_drawn_earlier():
    """Constant power moves nothing; a ramp of 10 W per row of 2 s moves 5 W/s times the lag."""
    rows = even(5, duration_s=[2.0] * 5)
    np.testing.assert_allclose(read_late(rows, np.full(5, 60.0), 0.5), [60.0] * 5)
    more = even(30, duration_s=[2.0] * 30)
    ramp = 2.0 * (10.0 * np.arange(30) + 30.0)
    np.testing.assert_allclose(read_late(more, ramp, 0.5)[10:-10], ramp[10:-10] - 2.0 * 5.0 * 0.5, rtol=1e-4)


@pytest.mark.parametrize(("stands_s", "idle_w"), [(None, ROBOT.idle_power_w), (20.0, 3.0)])
def test_at_a_stop_a_late_meter_says_what_was_drawn_before_it(stands_s, idle_w):
    """Metres of 30 W, a minute of rest, metres of 100 W. Half a second late, the first metre after the rest has half a
    second of rest in it, and no metre before the rest has anything of those after it."""
    clock = 2.0 * np.arange(20) + 60.0 * (np.arange(20) >= 10)
    power = np.where(np.arange(20) < 10, 30.0, 100.0)
    rows, energy = even(20, clock_s=clock), 2.0 * power
    if stands_s is not None:
        rows = concatenate_features([rows, even(1, length_m=[0.0], duration_s=[stands_s])])
        energy = np.append(energy, idle_w * stands_s)
    late = read_late(rows, energy, 0.5)
    expected = energy.copy()
    expected[10] += 0.5 * (idle_w - 100.0)
    np.testing.assert_allclose(late, expected)


def test_where_rows_are_missing_the_robot_went_on():
    """A gap of 40 m in the positions is no stop: the meter goes on from the metre before to the metre after."""
    gap = np.arange(20) >= 10
    rows = even(20, clock_s=2.0 * np.arange(20) + 60.0 * gap, y=np.arange(20) + 40.0 * gap)
    np.testing.assert_allclose(read_late(rows, np.full(20, 200.0), 0.5), 200.0)
