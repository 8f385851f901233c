"""A heading that jumps is not a robot that turns."""

import numpy as np
import pytest

from joulemap.model.runs.track import without_jumps


def test_a_first_guess_that_is_replaced_is_no_turn():
    t = 0.05 * np.arange(100)
    heading = np.full(t.size, 1.0)
    guessed = np.where(t < 2.0, heading + 2.06, heading)
    np.testing.assert_allclose(without_jumps(t, guessed), heading, atol=1e-12)
    np.testing.assert_array_equal(without_jumps(t, heading), heading)


@pytest.mark.parametrize("step_s", [0.05, 1.0])
def test_fast_turns_stay(step_s):
    """A turn on the spot at 3 rad/s; and one that is written once a second."""
    t = np.arange(0.0, 6.0, step_s)
    heading = 3.0 * t
    np.testing.assert_array_equal(without_jumps(t, heading), heading)
