"""What effects cost by their formulas, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.loop.effects import Term, turning_per_rad
from joulemap.model.loop.report import coefficient_names, coefficient_units, where_words
from joulemap.model.runs.track import TURN_LIMITS_RADPS
from tests.reference.drives import found_in, made_up, noisy


def test_a_radian_costs_the_same_in_words_of_either_form():
    rng = np.random.default_rng(4)
    drive = made_up(rng)
    limit = TURN_LIMITS_RADPS[2]
    gentle = drive.gentle_turn_rad[:, 2]
    (effect,) = found_in(drive, noisy(rng, drive, 300.0 * gentle)).effects
    assert effect.term.settings["limit_radps"] == limit
    turned = drive.turned_abs_rad
    usual = 300.0 * (turned @ gentle) / (turned @ turned)  # least squares of what turning took on what was turned
    assert effect.coefficients[0] == pytest.approx(usual, rel=0.1)
    where = where_words(replace(effect.term, coefficients=(usual,)))
    assert where.startswith(f"everywhere: turns slower than {limit:g} rad/s cost 300 J/rad. Above that rate")
    assert where.endswith(f"the mean over all turns is {usual:.3g} J/rad")
    assert turning_per_rad([effect.term], drive) == pytest.approx(effect.coefficients[0], rel=1e-3)  # plans pay as much
    plain = Term("turning", "turning", ("J/rad",), {"limit_radps": limit}, {}, (10.0,))
    np.testing.assert_allclose(plain.energy(drive), 10.0 * gentle)


def test_plans_pay_for_all_turning_that_was_found_and_for_nothing_else():
    drive = made_up(np.random.default_rng(5))
    right = np.square(drive.turned_abs_rad) @ (drive.turned_rad > 0) / np.square(drive.turned_abs_rad).sum()
    terms = [
        Term("turning", "turning", ("J/rad",), {"limit_radps": None}, {}, (14.0,)),
        Term("turning", "turning_sides", ("J/rad", "J/rad"), {}, {}, (100.0, 20.0)),
        Term("hotel_load", "hotel_load", ("W",), {}, {}, (5.0,)),
    ]
    assert turning_per_rad(terms, drive) == pytest.approx(14.0 + 100.0 * right + 20.0 * (1.0 - right))
    assert turning_per_rad(terms[2:], drive) == 0.0


def test_of_a_field_its_strongest_place_is_told():
    """Of one bell curve of 4 m, half is at sqrt(2 ln 2) x 4 m = 4.7 m, in steps of a quarter of its width."""
    settings = {"centres": [[0.0, 0.0], [100.0, 0.0]], "width_m": 4.0, "of_all": False}
    field = Term("local_friction", "place", ("", ""), settings, {}, (0.01, -0.08))
    assert where_words(field) == "a field over the map, strongest at x 100.0, y 0.0: -0.08, half of it 5 m away"
    sum_of_two = replace(field, settings=settings | {"centres": [[0.0, 0.0], [0.1, 0.0]]}, coefficients=(0.5, -0.4))
    assert "x 0.0, y 0.0: +0.1" in where_words(sum_of_two)


def test_units_are_told_where_they_are_known():
    warm = {"over": "column:temperature", "knots": [5.0, 12.5, 20.0], "of": "motion"}
    curve = Term("learned:temperature", "smooth", ("", ""), warm, {}, (0.2, -0.1))
    assert coefficient_names(curve) == ["at 5 degC", "at 20 degC"]
    assert coefficient_units(curve) == ["of the motion's energy"] * 2
    field = Term("learned:place", "place", ("",), {"centres": [[1.0, 2.0]], "width_m": 5.0, "of_all": True}, {}, (0.1,))
    assert coefficient_units(field) == ["of the predicted energy"]
    assert coefficient_units(replace(curve, units=("J/m",) * 2, settings=warm | {"of": "length"})) == ["J/m"] * 2
    friction = Term("rolling_resistance", "friction", ("",), {}, {"over": "column:temperature", "below": 3.0}, (0.03,))
    assert where_words(friction) == "where temperature is below 3 degC"
    assert coefficient_units(friction) == [""]  # a number
    grade = Term(
        "learned:grade", "smooth", ("",), {"over": "grade", "knots": [-0.07, 0.08], "of": "motion"}, {}, (0.3,)
    )
    assert coefficient_names(grade) == ["at -0.07"]
