"""Plans use the prediction that errs least on left-out runs, and the calibrated one where none is surely better."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.loop._proposal import proposed
from joulemap.model.loop.calibrate import calibrate
from joulemap.service.loop.calibration import correction_of
from tests.loop.calibrator import segments_of
from tests.loop.sums import case_of
from tests.reference.drives import made_up, measured_on

RNG = np.random.default_rng(3)
ROWS = made_up(RNG)
FOLD = ROWS.run


def drawn(**errors):
    """Runs, and predictions that err by some share of one disturbance; all others are of no use."""
    rows = measured_on(ROWS, RNG.uniform(50.0, 150.0, len(ROWS)))
    common = RNG.normal(0.0, 20.0, len(rows))
    said = {name: np.full(len(rows), 400.0) for name in ("after_planner", "least_squares", "constant", "before")}
    said |= {name: rows.measured + share * common + RNG.normal(0.0, 1.0, len(rows)) for name, share in errors.items()}
    return rows, said


def test_what_errs_least_is_proposed():
    rows, said = drawn(after_planner=1.0, least_squares=0.1)
    assert proposed(rows, said, FOLD)[0] == "least_squares"
    rows, said = drawn(after_planner=0.1, least_squares=0.5, before=1.0)
    assert proposed(rows, said, FOLD)[0] == "after_planner"


def test_a_gain_that_hangs_on_one_fold_is_none():
    rows, said = drawn(after_planner=0.0, least_squares=0.2)
    said["after_planner"][0] += 200.0
    assert proposed(rows, said, FOLD)[0] == "after_planner"


def test_errors_that_add_up_over_a_run_count_more_than_those_that_do_not():
    """3 J in every metre, all to one side in a run, beside 4 J that are independent."""
    rows, said = drawn(after_planner=0.0, least_squares=0.2)
    said["after_planner"] += np.resize([3.0, -3.0], int(FOLD.max()) + 1)[FOLD]
    metres = np.abs(rows.measured - said["after_planner"]).mean(), np.abs(rows.measured - said["least_squares"]).mean()
    assert metres[0] < metres[1]
    assert proposed(rows, said, FOLD)[0] == "least_squares"


def test_a_fold_has_no_part_in_its_own_choice():
    rows, said = drawn(after_planner=1.0, least_squares=0.1)
    mine = FOLD == 2
    said["least_squares"][mine] += 1e6
    chosen, judged = proposed(rows, said, FOLD)
    assert chosen == "after_planner"
    np.testing.assert_array_equal(judged[mine], said["least_squares"][mine])


@pytest.mark.parametrize("proposal", ["after_planner", "before", "least_squares", "constant"])
def test_plans_have_the_price_that_was_judged(proposal):
    case = case_of(0, 310, runs=4, length_m=60.0)[1]
    rows, electric, std = residuals_on(
        PhysicsPredictor(),
        case.new.site.heightmap,
        case.declared,
        segments_of(case.new.logs, case.declared),
    )
    found = calibrate(rows, electric=electric, cross_validate=False)
    correction = correction_of(replace(found, proposal=proposal), std)
    moved = rows.driven_by(correction.drives)
    planned = moved.said + correction.added_energy(moved.features, planned=True)
    judged = found.fitted.states(rows)[proposal]
    slowest, fastest = correction.ranges["speed"]
    inside = rows.moving & (rows.features.speed_mps >= slowest) & (rows.features.speed_mps <= fastest)
    np.testing.assert_allclose(planned[inside], judged[inside], rtol=1e-6)
