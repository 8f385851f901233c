"""The simulated field against closed forms, written here from mechanics and not taken from the simulator."""

import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import InputError, PointError
from joulemap.model.field.drives import Drive, drive_along
from joulemap.model.field.electrics import Pack, open_circuit_v, terminals
from joulemap.model.field.robot_dynamics import move
from joulemap.model.field.robots import FieldRobot, Ground
from joulemap.model.field.simulation import simulate_segments, simulate_trace, true_segments
from joulemap.model.field.sites import Site, named_site
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

G = 9.80665
BARE = Ground(
    "bare",
    mu=0.2,
    load_exponent=0.0,
    bump_loss=0.0,
    scrub=0.0,
    tpi_share=0.0,
    patchiness=0.0,
    spread=0.0,
    tussock_m=0.0,
)
IDEAL = replace(FieldRobot.nominal(Robot()), gear_efficiency=1.0, drag_n=0.0, copper_w_per_n2=0.0)
WEIGHT = IDEAL.mass_kg * G


def site_of(height, ground=BARE, size_m=12.0) -> Site:
    """A site whose height is a function of (x east, y north) [m]."""
    frame = GridFrame(0.0, size_m, 0.05, round(size_m / 0.05), round(size_m / 0.05))
    x, y = frame.centres()
    heights = np.broadcast_to(height(x[None, :], y[:, None]), frame.shape).astype(np.float32)
    terrain = Heightmap(heights, frame)
    coarse = frame.respaced(0.25)
    ones = Heightmap(np.ones(coarse.shape, np.float32), coarse)
    return Site("test", terrain, terrain, ground, ones, ones)


def straight(start, goal, speed=0.5) -> Drive:
    return drive_along([start, goal], speed_mps=speed, corner_m=0.0)


def trace_of(site, drive, robot=IDEAL, seed=0):
    return simulate_trace(site, robot, drive, rng=np.random.default_rng(seed))


def test_flat_ground_costs_constant_power():
    trace = trace_of(site_of(lambda x, y: 0 * x + 3.0), straight((2, 2), (9, 10)))
    np.testing.assert_allclose(trace.power_w, 12.0 + 0.2 * WEIGHT * 0.5, rtol=1e-6)
    assert trace.t[-1] == pytest.approx(math.hypot(7, 8) / 0.5, rel=1e-6)


def test_drivetrain_losses_on_flat_ground():
    robot = replace(IDEAL, gear_efficiency=0.8, drag_n=6.0, copper_w_per_n2=0.002)
    trace = trace_of(site_of(lambda x, y: 0 * x), straight((2, 2), (2, 9)), robot)
    motor = 0.5 * 0.2 * WEIGHT / 0.8 + 3.0  # N, of one side
    np.testing.assert_allclose(trace.power_w, 12.0 + 2 * (motor * 0.5 + 0.002 * motor**2), rtol=1e-6)


def test_climbing_power_on_a_plane():
    slope = math.tan(math.radians(10.0))
    trace = trace_of(site_of(lambda x, y: slope * y), straight((6, 2), (6, 10)))
    force = WEIGHT * (math.sin(math.radians(10)) + 0.2 * math.cos(math.radians(10)))
    np.testing.assert_allclose(trace.power_w[5:-5], 12.0 + force * 0.5, rtol=2e-3)
    np.testing.assert_allclose(np.degrees(trace.pitch_rad), 10.0, atol=0.01)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_steep_descent_brakes_or_regenerates(share):
    slope = math.tan(math.radians(20.0))
    robot = replace(IDEAL, regeneration=share)
    trace = trace_of(site_of(lambda x, y: slope * y), straight((6, 10), (6, 2)), robot)
    pushed = WEIGHT * (0.2 * math.cos(math.radians(20)) - math.sin(math.radians(20))) * 0.5
    np.testing.assert_allclose(trace.power_w[5:-5], 12.0 + share * pushed, atol=0.2)


def test_wheel_loads_on_a_cross_slope_balance_moments():
    angle = math.radians(12.0)
    site = site_of(lambda x, y: -math.tan(angle) * x)  # falls to the east; driving north the right side is low
    drive = straight((6, 3), (6, 8))
    motion = move(
        site.terrain,
        site.mu_factor,
        BARE,
        IDEAL,
        x=drive.x,
        y=drive.y,
        heading_rad=drive.heading_rad,
        speed_mps=drive.speed_mps,
    )
    loads = motion.loads_n[20]
    assert loads.sum() == pytest.approx(WEIGHT * math.cos(angle), rel=1e-4)
    right_minus_left = loads[1] + loads[3] - loads[0] - loads[2]
    about_track = 2 * WEIGHT * math.sin(angle) * IDEAL.com_height_m / IDEAL.track_m
    assert right_minus_left == pytest.approx(about_track, rel=1e-3)
    assert np.degrees(motion.roll_rad[20]) == pytest.approx(12.0, abs=0.01)


def test_side_slip_makes_a_cross_slope_dearer():
    angle = math.radians(15.0)
    across = trace_of(site_of(lambda x, y: -math.tan(angle) * x), straight((6, 2), (6, 10)))
    slide = math.sin(math.sin(angle) / IDEAL.lateral_grip)  # side force over grip is the slip angle
    expected = 12.0 + 0.5 * WEIGHT * (0.2 * math.cos(angle) + math.sin(angle) * slide)
    np.testing.assert_allclose(across.power_w[5:-5], expected, rtol=2e-3)


def _humps(centre_x):
    """Humps across the way, 12 cm wide, one every metre of northing, at this easting."""
    return lambda x, y: 0.04 * np.exp(-0.5 * ((x - centre_x) / 0.03) ** 2 - 0.5 * ((y % 1.0 - 0.5) / 0.06) ** 2)


def test_only_bumps_under_a_wheel_cost_and_left_equals_right():
    ground = replace(BARE, bump_loss=0.8)
    half = 0.5 * IDEAL.track_m
    costs = [
        trace_of(site_of(_humps(6.025 + offset), ground), straight((6.025, 2), (6.025, 10))).energy_j()[-1]
        for offset in (-half, half, 0.0)
    ]
    flat = trace_of(site_of(lambda x, y: 0 * x, ground), straight((6.025, 2), (6.025, 10))).energy_j()[-1]
    left, right, between = costs
    assert left == pytest.approx(right, rel=1e-5)
    assert between == pytest.approx(flat, rel=1e-6)
    assert left > flat + 20.0


def test_a_wheel_rolls_over_what_is_narrower_than_itself():
    # a slot of one cell (5 cm) across the way, 10 cm deep: a wheel of 12.7 cm cannot fall into it
    slot = site_of(lambda x, y: np.where((y > 6.0) & (y < 6.05), -0.10, 0.0) + 0 * x)
    trace = trace_of(slot, straight((6, 3), (6, 9)))
    # a circle that bridges a gap of 2 w sinks by R - sqrt(R^2 - w^2); bilinear flanks make the gap at most 10 cm
    assert 0 < -trace.z.min() < 0.127 - math.sqrt(0.127**2 - 0.05**2) + 1e-6


def test_turning_costs_more_and_both_ways_the_same():
    ground = replace(BARE, scrub=0.3)
    site = site_of(lambda x, y: 0 * x, ground)
    right = trace_of(site, drive_along([(3, 3), (3, 8), (8, 8)], speed_mps=0.5))
    left = trace_of(site, drive_along([(8, 3), (8, 8), (3, 8)], speed_mps=0.5))
    assert right.energy_j()[-1] == pytest.approx(left.energy_j()[-1], rel=1e-6)
    rolling = right.energy_j()[-1] - 12.0 * right.t[-1]
    path = np.hypot(np.diff(right.x), np.diff(right.y)).sum()
    assert rolling > 0.2 * WEIGHT * path + 5.0


def test_speeding_up_costs_the_kinetic_energy():
    site = site_of(lambda x, y: 0 * x)
    drive = straight((6, 1.5), (6, 10.5))
    faster = replace(drive, speed_mps=np.linspace(0.3, 0.9, drive.x.size))
    gained = trace_of(site, faster).energy_j()[-1] - 12.0 * trace_of(site, faster).t[-1]
    kinetic = 0.5 * IDEAL.mass_kg * (0.9**2 - 0.3**2)
    assert gained == pytest.approx(0.2 * WEIGHT * 9.0 + kinetic, rel=0.01)


def test_the_terminals_obey_the_battery():
    pack = Pack(28.8, 10.0, 0.12, temperature_c=25.0)
    power = np.linspace(5.0, 300.0, 40)
    volts, amps, charge = terminals(power, np.full(40, 2.0), pack)
    np.testing.assert_allclose(volts * amps, power, rtol=1e-12)
    source = [open_circuit_v(pack, c) for c in charge]
    np.testing.assert_allclose(volts, np.array(source) - 0.12 * amps, rtol=1e-12)
    assert charge[0] - charge[-1] == pytest.approx(2.0 * amps[:-1].sum() / 36000.0)
    cold, _, _ = terminals(power, np.full(40, 2.0), replace(pack, temperature_c=-5.0))
    assert (cold < volts).all()


def test_the_battery_refuses_more_than_it_has():
    with pytest.raises(InputError, match="cannot deliver 5000 W"):
        terminals(np.array([5000.0]), np.array([1.0]), Pack(28.8, 10.0, 0.12))


def test_leaving_the_terrain_is_an_error():
    with pytest.raises(PointError, match="leaves the known terrain"):
        trace_of(site_of(lambda x, y: 0 * x), straight((6, 6), (6, 12)))


def test_no_height_explains_five_to_seven_percent_on_grass():
    site = named_site("grass_a")
    rng = np.random.default_rng(0)
    west, south, east, north = site.drivable
    drive = drive_along([(west, south), (east, north), (east, south), (west, north)], speed_mps=0.5, rng=rng)
    robot = FieldRobot.nominal(Robot())
    drives = [simulate_segments(site, robot, drive, rng=np.random.default_rng(seed)) for seed in range(4)]
    floors = [np.mean(np.abs(found.explained_j - found.energy_j) / found.energy_j) for found in drives]
    assert 0.05 < np.mean(floors) < 0.07


def test_true_segments_are_straight_metres_and_telescope():
    site = named_site("grass_a", width_m=25.0, height_m=20.0)
    rng = np.random.default_rng(1)
    west, south, east, north = site.drivable
    drive = drive_along([(west, south), (east, north)], speed_mps=0.5, rng=rng)
    trace = simulate_trace(site, FieldRobot.nominal(Robot()), drive, rng=rng)
    segments = true_segments(trace, max_driven_m=2.0)
    assert len(segments) == int(math.hypot(east - west, north - south))
    ahead = np.column_stack([np.sin(segments.heading_rad), np.cos(segments.heading_rad)]) / 2
    centre = np.column_stack([segments.x, segments.y])
    np.testing.assert_allclose((centre + ahead)[:-1], (centre - ahead)[1:], atol=2e-3)
    assert segments.energy_j.sum() == pytest.approx(np.interp(segments.duration_s.sum(), trace.t, trace.energy_j()))
