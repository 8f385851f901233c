"""Forces are felt as far as the drives pull: against quadrature, and in data made without the loop's formulas."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from joulemap.model.loop.bend import Bend, bend_of, spread_of
from joulemap.model.loop.effects import Term
from joulemap.model.loop.residual import residuals_of
from tests.reference.drives import ROBOT, found_in, made_up, noisy

WEIGHT = ROBOT.weight_n
DRAG = Term("rolling_resistance", "friction", ("",))


def cost_by_quadrature(mean_n, spread_n, regeneration=0.0):
    """Mean cost of a metre [J] in which the force is normal: what pulls, and what regeneration returns of the rest."""
    at = norm.ppf((np.arange(4000) + 0.5) / 4000.0)
    force = np.asarray(mean_n)[:, None] + spread_n * at
    return (np.maximum(force, 0.0) + regeneration * np.minimum(force, 0.0)).mean(axis=1)


def bumpy(rng, spread_n, *, grade=0.08, gain=1.0, regeneration=0.0):
    """A drive over hills so steep that the ground pushes now and then, whose base model knows the bumps' share; and
    the mean force [N]."""
    drive = made_up(rng)
    slope = grade * drive.grade / drive.grade.std()
    force = gain * WEIGHT * (0.08 + slope)
    cost = cost_by_quadrature(force, spread_n, regeneration)
    traction = np.where(cost > 0, cost, cost / max(regeneration, 1e-9))
    robot = replace(ROBOT, regeneration=regeneration)
    return replace(
        drive, robot=robot, grade=slope, grades=np.repeat(slope[:, None], 5, 1), traction_per_m=traction
    ), force


def windy(rng, drive, mean=6.0):
    n = len(drive)
    gusts = mean * np.exp(0.2 * rng.standard_normal(n))
    return replace(drive, columns={"wind_speed": gusts, "wind_from": np.mod(20.0 * rng.standard_normal(n), 360.0)})


def drag(drive):
    """Speed squared of the air that meets the robot, along its way and signed, less that of its own speed [m2/s2]."""
    wind, source = drive.columns["wind_speed"], np.radians(drive.columns["wind_from"])
    ahead = drive.speed_mps + wind * np.cos(source - drive.heading_rad)
    return ahead * np.hypot(ahead, wind * np.sin(source - drive.heading_rad)) - drive.speed_mps**2


@pytest.mark.parametrize("regeneration", [0.0, 0.4])
@pytest.mark.parametrize("more", [-30.0, 1e-3, 50.0])
def test_what_a_force_costs_is_that_of_every_bump(regeneration, more):
    drive, force = bumpy(np.random.default_rng(0), 30.0, regeneration=regeneration)
    bend = Bend((1.0,), 30.0)
    felt = bend.felt_share(drive, np.full(len(drive), more))
    truth = cost_by_quadrature(force + more, 30.0, regeneration) - cost_by_quadrature(force, 30.0, regeneration)
    np.testing.assert_allclose(felt, truth / more, atol=0.01)
    assert felt.min() < 0.3 + regeneration < felt.max()


def test_of_an_even_metre_a_push_spares_no_more_than_the_drives_take():
    drive = made_up(np.random.default_rng(1))
    t = drive.traction_per_m
    spared = -50.0 * Bend((1.0,), 0.01).felt_share(drive, np.full(len(drive), -50.0))
    np.testing.assert_allclose(spared, np.maximum(t - 50.0, 0.0) - np.maximum(t, 0.0), atol=0.05)


@pytest.mark.parametrize("gain", [1.0, 1.6])
def test_the_spread_shows_in_how_the_base_bends_with_the_slope(gain):
    drive, _ = bumpy(np.random.default_rng(2), 30.0, gain=gain)
    assert spread_of(drive) == pytest.approx(30.0, rel=0.15)


def test_the_coefficient_is_what_the_force_cost_on_the_whole():
    drive, force = bumpy(np.random.default_rng(3), 30.0)
    extra = cost_by_quadrature(force + 0.05 * WEIGHT, 30.0) - cost_by_quadrature(force, 30.0)
    residuals = residuals_of(drive, drive.predicted + extra, ("a",) * 6, charge=False)
    plain = DRAG.columns(drive)
    bent = replace(DRAG, bend=bend_of(residuals, plain, 30.0)).columns(drive)[:, 0]
    fitted = (bent @ extra) / (bent @ bent)
    assert fitted == pytest.approx((plain[:, 0] @ extra) / (plain[:, 0] @ plain[:, 0]), rel=0.01)
    np.testing.assert_allclose(fitted * bent, extra, atol=0.6)  # joules of 19


@pytest.mark.parametrize("seed", range(3))
def test_a_wind_is_found_without_a_shadow_downhill(seed):
    rng = np.random.default_rng(seed)
    drive, force = bumpy(rng, 30.0, gain=1.4)
    drive = windy(rng, drive)
    felt = cost_by_quadrature(force + 0.8 * drag(drive), 30.0) - cost_by_quadrature(force, 30.0)
    (effect,) = found_in(drive, noisy(rng, drive, felt)).effects
    usual = float(drag(drive) @ felt / (drag(drive) @ drag(drive)))
    assert effect.term.name == "wind"
    assert effect.low[0] < usual < effect.high[0]
    assert effect.coefficients[0] == pytest.approx(usual, rel=0.1)
    assert Term.from_dict(json.loads(json.dumps(effect.term.as_dict()))) == effect.term


def test_a_load_on_every_metre_is_no_braking():
    rng = np.random.default_rng(5)
    drive, force = bumpy(rng, 30.0, gain=1.4)
    soft = np.where(rng.random(drive.x.size // 20) < 0.5, "sand", "grass").repeat(20)
    more = np.where(soft == "sand", 25.0, 0.0)
    felt = cost_by_quadrature(force + more, 30.0) - cost_by_quadrature(force, 30.0)
    found = found_in(replace(drive, words={"terrain": soft}), noisy(rng, drive, felt)).effects
    assert [e.term.name for e in found] == ["terrain_class"]
