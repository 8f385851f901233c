"""What effects cost by their formulas, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from model.loop.effects import Term
from model.loop.report import where_words
from model.loop.track import TURN_LIMITS_RADPS
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
    assert where_words(replace(effect.term, coefficients=(usual,))).startswith("everywhere; 300 J/rad up to")
    plain = Term("turning", "turning", ("J/rad",), {"limit_radps": limit}, {}, (10.0,))
    np.testing.assert_allclose(plain.energy(drive), 10.0 * gentle)
