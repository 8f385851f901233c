"""Answers are not dearer than those stored in `tests/bench/stored_answers.npz` (our own, regression only).

`python -m tests.bench.guard` compares all of them; here are the first tasks of the maps that need no recordings.
"""

import numpy as np
import pytest

from tests.bench.guard import CASES, compared

TASKS = 20
OPEN, OTHERS = (0.0003, 0.001, 0.003), (0.001, 0.005, 0.025)
"""Most that energies may be above the stored ones: mean, 95th percentile, worst. A robot that is 10 cm off its path, or
a map that is, changes the energy more."""
MAPS = [case for case in CASES if case.heightmap is not None]


def gaps_of(case):
    found = compared(case, None, TASKS)
    assert found is not None, f"the moves of {case.name} cost something else: no fault of the search; store it again"
    assert (found.gaps < found.grid_gaps).all()
    return found.gaps


def check(gaps, most):
    reached = np.array([gaps.mean(), np.percentile(gaps, 95), gaps.max()])
    assert (reached <= most).all(), reached


def test_answers_on_open_ground_cost_what_the_stored_ones_do():
    check(np.concatenate([gaps_of(case) for case in MAPS if case.open_ground]), OPEN)


@pytest.mark.parametrize("case", [case for case in MAPS if not case.open_ground], ids=lambda case: case.name)
def test_answers_where_more_than_the_ground_counts_cost_what_the_stored_ones_do(case):
    check(gaps_of(case), OTHERS)
