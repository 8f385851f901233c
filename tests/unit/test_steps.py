"""A record that changes once is judged by the residual's jump there, against all other places."""

import numpy as np

from joulemap.model.loop.steps import step_chance


def test_a_step_is_judged_by_the_jumps_of_all_other_places():
    rng = np.random.default_rng(2)
    run, state = np.repeat(np.arange(6), 120), np.repeat([0.0, 0.0, 0.0, 0.0, 1.0, 1.0], 120)
    state[4 * 120 : 4 * 120 + 60] = 0.0
    quiet = [step_chance(rng.standard_normal(720), state, run) for _ in range(200)]
    assert np.mean(np.array(quiet) < 0.05) < 0.09  # 0.05 and two standard errors of 200 tries
    assert step_chance(rng.standard_normal(720) + 3.0 * state, state, run) < 1e-4
    assert step_chance(3.0 * state, (run > 3).astype(float), run) == 1.0  # changes between runs only
