"""Hidden effects against closed forms on level ground and planes, written here from mechanics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import InputError
from joulemap.model.field.conditions import Conditions, Day, Halts, Wind
from joulemap.model.field.drives import drive_along
from joulemap.model.field.effects import Effect, Within
from joulemap.model.field.hidden_draws import EFFECT_NAMES, day_for, draw_effect
from joulemap.model.field.hidden_forces import (
    Acceleration,
    AirDrag,
    ColdGrease,
    Drift,
    Furrows,
    Payload,
    SideSlip,
    SoftClass,
    Speed,
    Turning,
    WetPatch,
)
from joulemap.model.field.hidden_losses import Braking, Connector, HotelLoad, HotMotors, SensorGain
from joulemap.model.field.logger import Logger, log_trace, simulate_run
from joulemap.model.field.robots import FieldRobot, Ground
from joulemap.model.field.simulation import simulate_trace, with_halts
from joulemap.model.field.sites import Site
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

G = 9.80665
BARE = Ground("bare", 0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
IDEAL = replace(
    FieldRobot.nominal(Robot()), gear_efficiency=1.0, drag_n=0.0, copper_w_per_n2=0.0, lateral_grip=1e9, lag_m=0.0
)
WEIGHT = IDEAL.mass_kg * G
IDLE = 12.0
LEVEL_W = IDLE + 0.2 * WEIGHT * 0.5


def site_of(height=lambda x, y: 0.0 * x, size_m=14.0) -> Site:
    frame = GridFrame(0.0, size_m, 0.05, round(size_m / 0.05), round(size_m / 0.05))
    x, y = frame.centres()
    heights = np.broadcast_to(height(x[None, :], y[:, None]), frame.shape).astype(np.float32)
    coarse = frame.respaced(0.25)
    ones = Heightmap(np.ones(coarse.shape, np.float32), coarse)
    return Site("test", Heightmap(heights, frame), Heightmap(heights, frame), BARE, ones, ones)


NORTH = drive_along([(7, 2), (7, 12)], speed_mps=0.5, corner_m=0.0)
SOUTH = drive_along([(7, 12), (7, 2)], speed_mps=0.5, corner_m=0.0)
EAST = drive_along([(2, 7), (12, 7)], speed_mps=0.5, corner_m=0.0)


def trace(*effects, drive=NORTH, site=None, conditions=None):
    return simulate_trace(
        site or site_of(), IDEAL, drive, rng=np.random.default_rng(0), effects=effects, conditions=conditions
    )


def plane(slope_deg):
    return site_of(lambda x, y: math.tan(math.radians(slope_deg)) * y)


def middle(values):
    return values[40:-40]


def test_an_effect_that_is_none_changes_no_bit():
    np.testing.assert_array_equal(trace(Effect()).power_w, trace().power_w)


def test_turning_pays_by_the_radian_and_nothing_straight_on():
    site = site_of(size_m=14.0)
    angle = np.linspace(0.0, 1.5 * math.pi, 400)
    circle = drive_along(np.c_[7 + 4 * np.sin(angle), 7 + 4 * np.cos(angle)], speed_mps=0.5, corner_m=0.0)
    scrub = Turning(0.4, sliding_rad_s=0.001)
    extra = trace(scrub, drive=circle, site=site).energy_j()[-1] - trace(drive=circle, site=site).energy_j()[-1]
    assert extra == pytest.approx(0.4 * WEIGHT * IDEAL.wheelbase_m / 2 * 1.5 * math.pi, rel=0.02)
    np.testing.assert_allclose(trace(scrub).power_w, LEVEL_W, rtol=1e-5)


def test_a_hotel_load_is_drawn_standing_too():
    driven = trace(HotelLoad(7.0))
    np.testing.assert_allclose(driven.power_w, LEVEL_W + 7.0, rtol=1e-6)
    assert driven.standing_w == IDLE + 7.0


def test_air_drag_goes_with_the_square_of_the_air_that_is_met():
    wind = Conditions(wind=Wind.steady(4.0, 0.0))  # from the north
    drag = AirDrag(0.5)
    ahead, behind, beside = (trace(drag, drive=d, conditions=wind).power_w for d in (NORTH, SOUTH, EAST))
    np.testing.assert_allclose(ahead, LEVEL_W + 0.5 * 1.2 * 0.5 * 4.5**2 * 0.5, rtol=1e-6)
    np.testing.assert_allclose(behind, LEVEL_W - 0.5 * 1.2 * 0.5 * 3.5**2 * 0.5, rtol=1e-6)
    np.testing.assert_allclose(beside, LEVEL_W + 0.5 * 1.2 * 0.5 * math.hypot(4, 0.5) * 0.5 * 0.5, rtol=1e-6)


def test_a_payload_weighs_on_every_newton():
    loaded = trace(Payload(), conditions=Conditions(payload_kg=10.0)).power_w
    np.testing.assert_allclose(loaded - IDLE, (LEVEL_W - IDLE) * (1 + 10.0 / IDEAL.mass_kg), rtol=1e-6)
    np.testing.assert_allclose(trace(conditions=Conditions(payload_kg=10.0)).power_w, LEVEL_W, rtol=1e-6)


def test_a_viscous_loss_grows_with_the_driver_s_speed():
    driven = trace(Speed(0.06, spread=0.3))
    v = driven.speed_mps
    assert v.std() > 0.04
    kinetic = 0.5 * IDEAL.mass_kg * (v[-1] ** 2 - v[0] ** 2)
    force_part = np.sum((0.2 + 0.06 * v[1:]) * WEIGHT * np.diff(driven.y))
    assert driven.energy_j()[-1] == pytest.approx(IDLE * driven.t[-1] + force_part + kinetic, rel=2e-3)


def test_spun_up_rotors_are_paid_at_every_start():
    driven, light = trace(Acceleration(100.0, every_m=2.5)), trace(Acceleration(0.0, every_m=2.5))
    assert driven.speed_mps.min() < 0.2
    gained = np.maximum(np.diff(0.5 * driven.speed_mps**2), 0.0).sum()
    assert driven.energy_j()[-1] - light.energy_j()[-1] == pytest.approx(100.0 * gained, rel=1e-3)


def test_cold_grease_drags_its_share_at_zero_and_nothing_when_warm():
    def day(celsius):
        return Conditions(mean_c=celsius, swing_c=0.0)

    frozen = trace(ColdGrease(0.03), conditions=day(0.0)).power_w
    np.testing.assert_allclose(frozen, LEVEL_W + 0.03 * WEIGHT * 0.5, rtol=1e-6)
    np.testing.assert_allclose(trace(ColdGrease(0.03), conditions=day(20.0)).power_w, LEVEL_W, rtol=1e-6)


def test_side_slip_is_side_force_squared_over_grip_and_load():
    site = plane(10.0)
    extra = trace(SideSlip(0.4), drive=EAST, site=site).power_w - trace(drive=EAST, site=site).power_w
    expected = WEIGHT * math.sin(math.radians(10.0)) ** 2 / 0.4 * 0.5
    np.testing.assert_allclose(middle(extra), expected, rtol=2e-3)
    straight = trace(SideSlip(0.4), site=site).power_w - trace(site=site).power_w
    np.testing.assert_allclose(middle(straight), 0.0, atol=1e-3)


def test_a_retarder_draws_its_share_of_the_power_released_downhill():
    site = plane(6.0)
    down = trace(Braking(0.5), drive=SOUTH, site=site).power_w - trace(drive=SOUTH, site=site).power_w
    np.testing.assert_allclose(middle(down), 0.5 * WEIGHT * math.sin(math.radians(6.0)) * 0.5, rtol=2e-3)
    up = trace(Braking(0.5), site=site).power_w - trace(site=site).power_w
    np.testing.assert_allclose(middle(up), 0.0, atol=1e-6)


def test_soft_ground_is_where_it_is_called_so():
    site = site_of().with_words(("grass", "gravel"), np.random.default_rng(5))
    driven = trace(SoftClass("gravel", 1.5), site=site)
    words = site.words_at(driven.x, driven.y)
    assert set(words) == {"grass", "gravel"}
    far = np.convolve(words == "gravel", np.ones(41) / 41, mode="same")  # a metre around is one kind of ground
    np.testing.assert_allclose(driven.power_w[far > 0.999], IDLE + 1.5 * (LEVEL_W - IDLE), rtol=1e-5)
    np.testing.assert_allclose(middle(driven.power_w)[middle(far) < 1e-9], LEVEL_W, rtol=1e-5)


def test_a_wet_patch_is_a_place():
    driven = trace(WetPatch(2.0, radius_m=2.0, east=0.5, north=0.5))
    at = np.argmin(np.abs(driven.y - 7.0))
    assert driven.power_w[at] == pytest.approx(IDLE + 2.0 * (LEVEL_W - IDLE), rel=1e-3)
    assert driven.power_w[5] == pytest.approx(LEVEL_W, rel=1e-3)


def test_mud_gathers_and_tyres_sink():
    later = Conditions(driven_m=500.0, start_s=86400.0 + 9.5 * 3600.0)
    mud = trace(Drift(0.02, "km"), conditions=later).power_w
    assert mud[0] == pytest.approx(LEVEL_W + 0.02 * 0.5 * WEIGHT * 0.5, rel=1e-4)
    assert mud[-1] - mud[0] == pytest.approx(0.02 * 0.01 * WEIGHT * 0.5, rel=1e-2)
    air = trace(Drift(0.005, "h"), conditions=later).power_w
    assert air[0] == pytest.approx(LEVEL_W + 0.005 * 2.0 * WEIGHT * 0.5, rel=1e-4)


def test_furrows_cost_across_and_not_along():
    furrows = Furrows(0.03, along_rad=math.pi / 2)
    np.testing.assert_allclose(trace(furrows).power_w, LEVEL_W + 0.03 * WEIGHT * 0.5, rtol=1e-6)
    np.testing.assert_allclose(trace(furrows, drive=EAST).power_w, LEVEL_W, rtol=1e-6)


def test_a_connector_takes_current_squared_times_resistance():
    np.testing.assert_allclose(
        trace(Connector(1.5, volts=28.8)).power_w, LEVEL_W + 1.5 * (LEVEL_W / 28.8) ** 2, rtol=1e-6
    )


def test_hot_motors_weaken_as_they_warm():
    cool = Conditions(mean_c=10.0, swing_c=0.0)
    driven = trace(HotMotors(0.02, from_c=10.0), conditions=cool)
    excess = (driven.power_w - IDLE) / (LEVEL_W - IDLE) - 1.0
    assert excess[0] == pytest.approx(0.02 * 3.0, rel=0.05)  # the housing starts 3 K above the air
    assert (np.diff(excess) > 0).all()
    np.testing.assert_allclose(trace(HotMotors(0.02, from_c=60.0), conditions=cool).power_w, LEVEL_W, rtol=1e-6)


def test_a_wrong_meter_changes_the_log_and_nothing_else():
    def logged(*effects):
        return simulate_run(
            site_of(),
            IDEAL,
            NORTH,
            rng=np.random.default_rng(0),
            logger=Logger.perfect(),
            effects=effects,
            conditions=Conditions(),
        ).columns

    np.testing.assert_allclose(logged(SensorGain(1.2))["current"], 1.2 * logged()["current"], rtol=1e-12)
    np.testing.assert_array_equal(logged(SensorGain(1.2))["voltage"], logged()["voltage"])


def test_an_effect_may_act_in_part_of_the_range():
    site = plane(5.0)
    uphill = Within(HotelLoad(9.0), "grade_deg", above=1.0)
    assert (uphill.name, uphill.unit) == ("hotel_load", "W")
    up = trace(uphill, site=site).power_w - trace(site=site).power_w
    down = trace(uphill, drive=SOUTH, site=site).power_w - trace(drive=SOUTH, site=site).power_w
    np.testing.assert_allclose(middle(up), 9.0)
    np.testing.assert_allclose(middle(down), 0.0)
    with pytest.raises(InputError, match="range"):
        Within(HotelLoad(9.0), "grade_deg", above=2.0, below=1.0)


def test_conditions_are_logged_whether_they_matter_or_not():
    there = Conditions(
        start_s=50000.0, wind=Wind.steady(3.0, math.pi / 2), wind_logged=True, payload_kg=2.0, mean_c=5.0, swing_c=4.0
    )
    columns = log_trace(trace(conditions=there), IDEAL, rng=np.random.default_rng(1), conditions=there).columns
    assert np.median(columns["wind_speed"]) == pytest.approx(3.0, abs=0.1)
    assert np.median(columns["wind_from"]) == pytest.approx(90.0, abs=1.5)
    assert set(columns["payload"]) == {2.0}
    # 13.9 h on a day of 5 +- 4 degC that is warmest at 16 h
    assert np.median(columns["temperature"]) == pytest.approx(5.0 + 4.0 * math.cos(2.1 / 24 * 2 * math.pi), abs=0.1)
    assert columns["t"][0] == pytest.approx(50000.0, abs=0.1)
    hidden = replace(there, wind_logged=False, payload_logged=False)
    columns = log_trace(trace(conditions=hidden), IDEAL, rng=np.random.default_rng(1), conditions=hidden).columns
    assert np.isnan(columns["wind_speed"]).all()
    assert np.isnan(columns["payload"]).all()


def test_a_gusty_wind_has_its_mean_and_its_spread():
    wind = Wind.gusty(5.0, 1.0, np.random.default_rng(2))
    assert wind.speed_mps.mean() == pytest.approx(5.0, rel=0.1)
    assert 0.15 < wind.speed_mps.std() / 5.0 < 0.4
    with pytest.raises(InputError):
        Wind(np.array([-1.0]), np.array([0.0]))


def test_a_halt_takes_time_and_standing_power_only():
    driven = trace(HotelLoad(5.0))
    halted = with_halts(driven, Halts(np.array([100, 250]), np.array([4.0, 6.0])))
    assert halted.t[-1] == pytest.approx(driven.t[-1] + 10.0)
    assert halted.energy_j()[-1] == pytest.approx(driven.energy_j()[-1] + 10.0 * (IDLE + 5.0))
    np.testing.assert_array_equal(halted.x[101], halted.x[100])
    assert halted.t[101] - halted.t[100] == pytest.approx(4.0)
    assert (np.diff(halted.t) > 0).all()


def test_the_wind_goes_on_while_the_robot_stands():
    halts = Halts(np.array([100, 250]), np.array([4.0, 6.0]))
    there = Conditions(wind=Wind.gusty(5.0, 0.0, np.random.default_rng(5)), halts=halts)
    halted = with_halts(trace(AirDrag(0.5), conditions=there), halts)
    moving = halted.speed_mps > 0
    wind, source = there.wind.at(halted.t)
    ahead = 0.5 + wind * np.cos(source)
    force = 0.5 * 1.2 * 0.5 * ahead * np.hypot(ahead, wind * np.sin(source))
    np.testing.assert_allclose(halted.power_w[moving], (LEVEL_W + 0.5 * force)[moving], rtol=1e-6)


@pytest.mark.parametrize("name", EFFECT_NAMES)
def test_every_effect_is_drawn_by_name(name):
    rng = np.random.default_rng(0)
    effect = draw_effect(name, rng, IDEAL)
    assert effect.name in (name, f"learned:{name}", "turning")
    assert isinstance(day_for([effect], rng), Day)
    assert draw_effect(name, np.random.default_rng(7), IDEAL) == draw_effect(name, np.random.default_rng(7), IDEAL)
