"""What effects cost by their formulas, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from model.loop.effects import Term
from model.loop.formulas import FORMULAS
from model.loop.report import where_words
from model.loop.track import TURN_LIMITS_RADPS
from tests.reference.drives import found_in, made_up, noisy


def windy(rng, drive, mean=6.0):
    n = len(drive)
    gusts = mean * np.exp(0.2 * rng.standard_normal(n))
    return replace(drive, columns={"wind_speed": gusts, "wind_from": np.mod(20.0 * rng.standard_normal(n), 360.0)})


def drag(drive):
    """Speed squared of the air that meets the robot, along its way and signed, less that of its own speed [m2/s2]."""
    wind, source = drive.columns["wind_speed"], np.radians(drive.columns["wind_from"])
    ahead = drive.speed_mps + wind * np.cos(source - drive.heading_rad)
    return ahead * np.hypot(ahead, wind * np.sin(source - drive.heading_rad)) - drive.speed_mps**2


def test_a_push_spares_no_more_than_the_drives_would_take():
    drive = windy(np.random.default_rng(1), made_up(np.random.default_rng(0)))
    spared = 0.6 * FORMULAS["wind_measured"](drive, quadratic=True, felt=0.6)[:, 0]
    t, force = drive.traction_per_m, 0.6 * drag(drive)
    np.testing.assert_allclose(spared, np.maximum(t + force, 0.0) - np.maximum(t, 0.0), atol=1e-9)
    assert (spared > force + 1.0).mean() > 0.05  # there are such places
    plain = FORMULAS["wind_measured"](drive, quadratic=True)[:, 0]
    np.testing.assert_allclose(plain, drag(drive), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_drag_of_a_strong_wind_is_found_where_it_pushes_too(seed):
    rng = np.random.default_rng(seed)
    drive = windy(rng, made_up(rng))
    felt = np.maximum(drive.traction_per_m + 0.8 * drag(drive), 0.0) - np.maximum(drive.traction_per_m, 0.0)
    effects = found_in(drive, noisy(rng, drive, felt)).effects
    assert [e.term.name for e in effects] == ["wind"]
    assert effects[0].term.settings["felt"] > 0
    assert effects[0].low[0] < 0.8 < effects[0].high[0]
    assert effects[0].coefficients[0] == pytest.approx(0.8, rel=0.1)


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
