"""Plans use the mean of predictions that errs least on left-out runs, or the calibrated model alone."""

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.loop._stacking import best_shares, stacked
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.loop.mixture import PREDICTIONS, mean_of
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
    said = {name: np.full(len(rows), 400.0) for name in PREDICTIONS}
    said |= {name: rows.measured + share * common + RNG.normal(0.0, 1.0, len(rows)) for name, share in errors.items()}
    return rows, said


def test_errors_to_both_sides_cancel():
    rows, said = drawn(after_planner=1.0, least_squares=-1.0)
    shares = best_shares(rows, said, FOLD)
    assert shares == {"after_planner": pytest.approx(0.5, abs=0.02), "least_squares": pytest.approx(0.5, abs=0.02)}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert np.std(mean_of(shares, said) - rows.measured) < 0.1 * np.std(said["after_planner"] - rows.measured)


def test_a_model_that_is_right_is_taken_alone():
    rows, said = drawn(after_planner=0.1, least_squares=0.5, before=1.0)
    assert best_shares(rows, said, FOLD) == {"after_planner": 1.0}


def test_a_gain_that_hangs_on_one_fold_is_none():
    rows, said = drawn(after_planner=0.0, least_squares=0.2)
    said["after_planner"][0] += 200.0
    assert best_shares(rows, said, FOLD) == {"after_planner": 1.0}


def test_errors_that_add_up_over_a_run_count_more_than_those_that_do_not():
    """4 J in every metre, all to one side in a run, beside 4 J that are independent."""
    rows, said = drawn(after_planner=0.0, least_squares=0.2)
    said["after_planner"] += np.resize([3.0, -3.0], int(FOLD.max()) + 1)[
        FOLD
    ]  # half of the other's error in each metre
    assert best_shares(rows, said, FOLD).get("least_squares", 0.0) > 0.5


def test_a_fold_has_no_part_in_its_own_shares():
    rows, said = drawn(after_planner=1.0, least_squares=-1.0)
    mine = FOLD == 2
    said["least_squares"][mine] += 1e6
    without = best_shares(rows.take(~mine), {name: value[~mine] for name, value in said.items()}, FOLD[~mine])
    np.testing.assert_allclose(stacked(rows, said, FOLD)[1][mine], mean_of(without, said)[mine])


def test_plans_have_the_price_that_was_judged():
    """Of metres on a map: the mean of the predictions that were judged on left-out runs."""
    case = case_of(0, 310, runs=4, length_m=60.0)[1]
    rows, electric, std = residuals_on(
        PhysicsPredictor(),
        case.new.site.heightmap,
        case.declared,
        segments_of(case.new.logs, case.declared),
    )
    found = calibrate(rows, electric=electric, cross_validate=False)
    object.__setattr__(found, "shares", dict(zip(PREDICTIONS, (0.4, 0.3, 0.1, 0.2), strict=True)))
    correction = correction_of(found, std)
    moved = rows.driven_by(correction.drives)
    planned = moved.said + correction.added_energy(moved.features, planned=True)
    judged = mean_of(found.shares, found.fitted.states(rows))
    slowest, fastest = correction.ranges["speed"]
    inside = rows.moving & (rows.features.speed_mps >= slowest) & (rows.features.speed_mps <= fastest)
    np.testing.assert_allclose(planned[inside], judged[inside], rtol=1e-6)
