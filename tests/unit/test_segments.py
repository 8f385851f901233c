"""Cutting segments: exact answers on lines, circles and interrupted drives."""

import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.describe import describe_segments
from joulemap.model.runs.reader import Run
from joulemap.model.runs.segments import concatenate_segments, coverage_words, driven_only
from joulemap.model.terrain.heightmap import Heightmap


def run_along(x, y, *, rate_hz=10.0, volts=28.0, amps=2.0, name="run", **extras) -> Run:
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    n = x.size
    power = {"current_a": np.broadcast_to(amps, n).astype(float), "voltage_v": np.broadcast_to(volts, n).astype(float)}
    return Run(name, np.arange(n) / rate_hz, x, y, **power, extras={k: np.asarray(v, float) for k, v in extras.items()})


def line(seconds=60.0, speed=0.5, heading_deg=30.0, **options) -> Run:
    s = speed * np.arange(0.0, seconds, 0.1)
    h = math.radians(heading_deg)
    return run_along(100 + s * math.sin(h), 50 + s * math.cos(h), **options)


def test_a_straight_drive_at_constant_power():
    segments = cut_segments(line())
    assert len(segments) == 30  # 29.95 m
    each = 29.95 / 30
    np.testing.assert_allclose(segments.energy_j, 28.0 * 2.0 * 2.0 * each, rtol=1e-9)  # 56 W for 2 s per metre
    np.testing.assert_allclose(segments.duration_s, 2.0 * each, rtol=1e-9)
    np.testing.assert_allclose(segments.driven_m, each, rtol=1e-9)
    np.testing.assert_allclose(segments.heading_rad, math.radians(30.0), atol=1e-9)
    np.testing.assert_allclose(segments.heading_change_rad, 0.0, atol=1e-9)
    np.testing.assert_allclose(segments.kinetic_m2ps2, 0.0, atol=1e-9)
    np.testing.assert_array_equal(segments.standing_s, 0.0)
    s = each * (0.5 + np.arange(30))
    np.testing.assert_allclose(segments.x, 100 + s * 0.5, atol=1e-9)
    np.testing.assert_allclose(segments.y, 50 + s * math.cos(math.radians(30.0)), atol=1e-9)
    assert segments.left_out == {}
    assert segments.coverage() == {
        "track_m": pytest.approx(29.95),
        "used_m": pytest.approx(29.95),
        "left_out_m": {},
    }


def test_a_stand_counts_beside_segments_of_its_run_only():
    rest = np.full(100, 100.0), np.full(100, 50.0)
    runs = []
    for name in ("a", "b"):
        drive = line(name=name)
        x, y = (np.concatenate([start, along]) for start, along in zip(rest, (drive.x, drive.y), strict=True))
        amps = np.where(np.arange(x.size) < 100, 0.5, 2.0)
        runs.append(cut_segments(run_along(x, y, name=name, amps=amps, temperature=np.full(x.size, 12.0))))
    segments = concatenate_segments(runs)
    assert {interval[0] for interval in segments.stationary} == {0, 1}
    ground = Heightmap(np.zeros((120, 120), np.float32), GridFrame(50.0, 130.0, 1.0, 120, 120))
    for some, runs_left in ((segments, {0, 1}), (segments.take(segments.run == 0), {0})):
        drive, measured = describe_segments(some, ground, Robot(), np.full(len(some), 30.0))
        assert set(drive.run[drive.standing]) == runs_left
        assert (drive.columns["temperature"] == 12.0).all()
        last = np.flatnonzero(drive.standing)[0]  # of the first run
        for values in (drive.since_s, drive.clock_s, drive.driven_m):
            assert values[last] == pytest.approx(values[~drive.standing & (drive.run == 0)].mean())
        np.testing.assert_allclose(measured[drive.standing] / drive.duration_s[drive.standing], 14.0, rtol=0.02)


def test_rising_power_is_integrated_exactly():
    t = np.arange(600) / 10.0
    segments = cut_segments(replace(line(), current_a=1.0 + 0.05 * t, voltage_v=np.full(600, 20.0)))
    a, b = segments.t0, segments.t0 + segments.duration_s
    np.testing.assert_allclose(segments.energy_j, 20.0 * ((b - a) + 0.025 * (b**2 - a**2)), rtol=1e-9)


def circle(radius=3.0):
    angle = 0.5 / radius * np.arange(0.0, 60.0, 0.1)  # clockwise from its northern point
    return run_along(radius * np.sin(angle), radius * np.cos(angle))


def test_along_a_circle_segments_lie_on_it():
    segments = cut_segments(circle())
    inner = slice(1, -1)
    np.testing.assert_allclose(segments.driven_m, 29.95 / 30, rtol=5e-3)
    np.testing.assert_allclose(segments.heading_change_rad[inner], 29.95 / 30 / 3.0, rtol=5e-3)
    np.testing.assert_allclose(np.hypot(segments.x, segments.y)[inner], 3.0, rtol=5e-3)
    tangent = np.arctan2(segments.x, segments.y) + math.pi / 2
    np.testing.assert_allclose(np.cos(segments.heading_rad - tangent)[inner], 1.0, atol=1e-4)


def test_noise_of_a_centimetre_does_not_lengthen_the_track():
    run, rng = line(seconds=400.0), np.random.default_rng(0)
    noisy = replace(run, x=run.x + 0.01 * rng.standard_normal(len(run)), y=run.y + 0.01 * rng.standard_normal(len(run)))
    segments = cut_segments(noisy)
    assert segments.driven_m.mean() < 1.01
    assert segments.duration_s.mean() == pytest.approx(2.0, rel=5e-3)
    assert segments.duration_s.std() < 0.05


def test_no_segment_spans_a_gap_or_a_break():
    run = line()
    keep = (run.t < 20.0) | (run.t > 23.0)
    cut = Run("gap", run.t[keep], run.x[keep], run.y[keep], run.current_a[keep], run.voltage_v[keep])
    segments = cut_segments(cut)
    assert segments.left_out["gaps"] == 1
    ends = segments.t0 + segments.duration_s
    assert ((ends <= 20.0) | (segments.t0 >= 23.0)).all()
    broken = np.zeros(600, dtype=bool)
    broken[300] = True
    segments = cut_segments(replace(run, breaks=broken))
    assert segments.left_out["gaps"] == 1
    assert not ((segments.t0 < 29.9) & (segments.t0 + segments.duration_s > 30.0)).any()


def test_short_blanks_of_the_position_are_bridged():
    run = line()
    x = run.x.copy()
    x[100:104] = np.nan
    segments = cut_segments(replace(run, x=x))
    np.testing.assert_allclose(segments.duration_s, 2.0 * 29.95 / 30, rtol=1e-6)
    assert len(segments) == 30


def test_a_blank_is_bridged_as_far_as_a_straight_line_tells_the_place():
    run = line()
    for metres, gaps in ((2.3, 0), (2.6, 1)):  # 2.41 m is the limit
        x = run.x.copy()
        x[200 : 200 + round(20 * metres)] = np.nan
        segments = cut_segments(replace(run, x=x))
        assert segments.left_out.get("gaps", 0) == gaps
        assert segments.track_m == pytest.approx(29.95)
        if gaps:
            assert segments.left_out_m["gaps"] == pytest.approx(metres, abs=0.06)
        assert segments.used_m + segments.left_out_m.get("gaps", 0.0) == pytest.approx(segments.track_m)


def stop_and_go(seconds: float) -> Run:
    """North for 10 m, a stop, and again 10 m, at 0.5 m/s; 100 W while driving and 20 W while standing."""
    n = round(10 * seconds)
    s = np.concatenate([0.05 * np.arange(200), np.full(n, 10.0), 10 + 0.05 * np.arange(1, 201)])
    amps = np.concatenate([np.full(200, 5.0), np.full(n, 1.0), np.full(200, 5.0)])
    return run_along(0 * s, s, volts=20.0, amps=amps)


def test_a_long_stop_is_in_no_segment():
    segments = cut_segments(stop_and_go(15.0))
    assert segments.left_out == {"stops": 1}
    assert segments.used_m == pytest.approx(segments.track_m) == pytest.approx(20.0, abs=0.1)
    assert len(segments) == 20
    assert segments.duration_s.sum() == pytest.approx(40.0, abs=1.2)  # smoothing lengthens starts
    assert segments.energy_j.sum() == pytest.approx(4000.0, rel=0.01)
    ((_, seconds, energy),) = segments.stationary
    assert seconds == pytest.approx(14.0, abs=1.2)
    assert energy == pytest.approx(20.0 * seconds, rel=1e-6)


def test_a_short_stop_is_part_of_its_segment():
    segments = cut_segments(stop_and_go(1.5))
    assert segments.left_out == {}
    assert segments.duration_s.sum() == pytest.approx(41.4)
    assert segments.energy_j.sum() == pytest.approx(20.0 * np.trapezoid(stop_and_go(1.5).current_a) * 0.1)
    assert 0.3 < segments.standing_s.sum() < 1.5  # smoothing makes braking and starting slower
    assert segments.standing_s.sum() == segments.standing_s[9:11].sum() > 0


def test_starting_and_braking_are_changes_of_half_the_squared_speed():
    t = np.arange(0.0, 40.0, 0.1)
    speed = np.interp(t, [0.0, 5.0, 15.0, 20.0, 40.0], [0.5, 0.5, 1.5, 1.5, 0.5])
    s = np.cumsum(speed) * 0.1
    segments = cut_segments(run_along(s, 0 * s))
    assert segments.kinetic_m2ps2.sum() == pytest.approx(0.0, abs=0.01)
    assert segments.gained_m2ps2.sum() == pytest.approx(0.5 * (1.5**2 - 0.5**2), rel=0.02)
    middle = segments.t0 + segments.duration_s / 2
    faster, slower = (middle > 6.0) & (middle < 14.0), (middle > 22.0) & (middle < 38.0)
    np.testing.assert_allclose(segments.kinetic_m2ps2[faster], 0.1 * segments.driven_m[faster], rtol=0.05)  # a s
    np.testing.assert_allclose(segments.kinetic_m2ps2[slower], -0.05 * segments.driven_m[slower], rtol=0.05)
    np.testing.assert_allclose(segments.gained_m2ps2[slower], 0.0, atol=1e-6)


def test_turning_on_the_spot_is_no_stop_and_makes_no_metres():
    rng = np.random.default_rng(0)
    n = 100  # 10 s for half a turn
    s = np.concatenate([0.05 * np.arange(210), np.full(n, 10.5), 10.5 - 0.05 * np.arange(1, 191)])
    turn = np.concatenate([np.zeros(210), np.linspace(0.0, 180.0, n), np.full(190, 180.0)])
    noise = 0.01 * rng.standard_normal((2, s.size))
    with_compass = run_along(noise[0], s + noise[1], heading=turn)
    segments = cut_segments(with_compass)
    assert segments.left_out == {}
    assert segments.stationary == ()
    assert segments.used_m == pytest.approx(20.0, abs=0.2)
    turning = np.argmax(segments.turned_abs_rad)
    assert segments.turned_abs_rad[turning] == pytest.approx(math.pi, rel=0.05)
    assert segments.turned_abs_rad.sum() == pytest.approx(math.pi, abs=0.3)
    assert segments.duration_s[turning] == pytest.approx(12.0, abs=1.0)
    assert segments.standing_s[turning] < 1.0
    wheels = np.where(np.abs(np.arange(s.size) - 259.5) < 50, 0.2, 0.5)
    rolling = run_along(noise[0], s + noise[1], speed_left=wheels, speed_right=wheels)
    assert cut_segments(rolling).stationary == ()
    assert len(cut_segments(run_along(noise[0], s + noise[1])).stationary) == 1  # positions alone do not tell


def test_a_standing_robot_makes_no_metres():
    rng = np.random.default_rng(1)
    x, y = 0.01 * rng.standard_normal((2, 6000))  # ten minutes, positions as of RTK
    segments = cut_segments(run_along(x, y))
    assert len(segments) == 0
    assert segments.track_m < 0.5
    assert sum(interval[1] for interval in segments.stationary) > 500.0


def test_nothing_is_left_out_for_its_energy_its_duration_or_its_bends():
    s = 0.05 * np.arange(161)  # 3.5 m north, then 4.5 m back on a parallel 0.2 m to the east
    x = np.where(s < 3.5, 0.0, 0.2)
    y = np.where(s < 3.5, s, 7.0 - s)
    bent = run_along(x, y)
    t = np.arange(0.0, 80.0, 0.1)
    way = np.where(t < 20.0, 0.5 * t, 10.0 + 0.1 * (t - 20.0))  # 10 m, and 6 m at a fifth of the speed
    slow = run_along(way, 0 * way)
    fed_back = line(amps=np.where(np.arange(600) < 300, 2.0, -1.0))
    for run, metres in ((bent, 8.0), (slow, 16.0), (fed_back, 29.95)):
        segments = cut_segments(run)
        assert segments.left_out == {}
        assert segments.used_m == pytest.approx(metres, rel=0.02)
    assert (segments.energy_j < 0).sum() == pytest.approx(15, abs=1)
    assert segments.energy_j.sum() == pytest.approx(28.0 * np.trapezoid(fed_back.current_a) * 0.1)


def test_charge_for_logs_without_voltage():
    run = replace(line(), voltage_v=None)
    with pytest.raises(RunsError, match="no voltage"):
        cut_segments(run)
    segments = cut_segments(run, charge=True)
    assert segments.charge
    np.testing.assert_allclose(segments.energy_j, 2.0 * segments.duration_s, rtol=1e-9)


def test_further_columns_are_averaged_and_angles_as_directions():
    n = 600
    heading = np.where(np.arange(n) % 2 == 0, 359.0, 3.0)
    payload = np.full(n, 4.0)
    payload[::3] = np.nan
    run = line(heading=heading, payload=payload, blank=np.full(n, np.nan), height=np.arange(n) / 10.0)
    run = replace(run, texts={"terrain": np.array(["grass"] * 300 + ["dirt"] * 300)})
    segments = cut_segments(run)
    np.testing.assert_allclose(segments.extras["heading"], 1.0, atol=0.2)
    np.testing.assert_allclose(segments.extras["payload"], 4.0)
    assert np.isnan(segments.extras["blank"]).all()
    np.testing.assert_allclose(segments.extras["height"], segments.t0 + 1.0, atol=0.11)
    assert segments.texts["terrain"][0] == "grass"
    assert segments.texts["terrain"][-1] == "dirt"


def test_runs_are_put_together_and_taken_out_whole():
    parts = [
        cut_segments(line(seconds, name=f"r{k}", z=np.full(round(seconds * 10), k)))
        for k, seconds in enumerate((20.0, 30.0, 40.0))
    ]
    bare = replace(parts[1], extras={})
    together = concatenate_segments([parts[0], bare, parts[2]])
    assert together.runs == ("r0", "r1", "r2")
    assert len(together) == sum(map(len, parts))
    assert together.track_m == pytest.approx(10.0 + 15.0 + 20.0 - 3 * 0.05)
    assert together.used_m == pytest.approx(together.track_m)
    held = together.take(together.run == 1)
    assert set(held.run) == {1}
    assert held.runs == together.runs
    assert held.track_m == together.track_m
    assert np.isnan(held.extras["z"]).all()
    np.testing.assert_array_equal(held.energy_j, parts[1].energy_j)
    with pytest.raises(InputError, match="charge"):
        concatenate_segments([parts[0], cut_segments(line(), charge=True)])
    with pytest.raises(InputError, match="no segments"):
        concatenate_segments([])


def test_a_robot_that_is_carried_does_not_drive():
    t = np.arange(0.0, 60.0, 0.1)

    def moved(seconds: float) -> Run:
        speed = np.where(t < seconds, 0.5, 4.0)  # driven, then carried at a run
        x = np.concatenate([[0.0], np.cumsum(speed[:-1] * 0.1)])
        return Run("carried", t, x, np.zeros_like(x), np.full_like(t, 3.0), np.full_like(t, 24.0))

    driven = cut_segments(moved(56.0), max_speed_mps=1.5)
    assert driven.left_out["fast"] == pytest.approx(16, abs=1)
    assert driven.left_out_m["fast"] + driven.used_m == pytest.approx(driven.track_m)
    assert len(driven) == pytest.approx(28, abs=1)
    mostly_carried = cut_segments(moved(30.0), max_speed_mps=1.5)  # 15 of 134 m are slow: a car at a crossing
    assert len(mostly_carried) == 0
    assert mostly_carried.left_out_m["undriven"] == pytest.approx(15.0, abs=1.0)
    assert sum(mostly_carried.left_out_m.values()) == pytest.approx(mostly_carried.track_m)


def test_a_run_whose_wheels_stand_was_carried_whatever_it_draws():
    t = np.arange(0.0, 40.0, 0.1)

    def drawing(name: str, current_a: float, wheels: float) -> Run:
        extras = {"speed_left": np.full_like(t, wheels), "speed_right": np.full_like(t, wheels)}
        return Run(name, t, 0.5 * t, 0 * t, np.full_like(t, current_a), np.full_like(t, 24.0), extras=extras)

    runs = (("a", 3.0, 0.5), ("b", 0.1, 0.5), ("c", 3.0, 0.0))
    parts = [cut_segments(drawing(*run)) for run in runs]
    found = driven_only(concatenate_segments(parts))
    assert found.left_out["undriven"] == len(parts[2])
    assert found.left_out_m["undriven"] == pytest.approx(parts[2].used_m)
    assert set(found.run) == {0, 1}
    assert found.runs == ("a", "b", "c")
    unknown = replace(parts[2], extras={})
    assert len(driven_only(unknown)) == len(unknown)


def test_what_is_used_is_said_in_metres():
    run = line()
    x = run.x.copy()
    x[200:260] = np.nan  # 3 m
    coverage = cut_segments(replace(run, x=x)).coverage()
    assert coverage_words(coverage) == "27 of 30 m (89.8 %); left out: 3 m gaps"
    assert coverage_words(cut_segments(run).coverage()) == "30 of 30 m (100.0 %)"
