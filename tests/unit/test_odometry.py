"""Wheel speeds into tracks: arcs in closed form, turns on the spot, and the real Husky where it lies beside."""

import numpy as np
import pytest

from joulemap.model.errors import InputError, RunsError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.odometry import (
    Odometry,
    flat_heightmap,
    integrate,
    terrain_in_name,
)
from joulemap.model.runs.reader import read_run
from joulemap.model.runs.rolling import cut_travel, rolled_m

HUSKY_TRACK_M = 1.07
"""Effective track of a Clearpath Husky A200: wheel_separation 0.571 m times wheel_separation_multiplier 1.875.
Source: husky_control/config/control.yaml of the robot's ROS packages."""


def write(path, left, right, current=3.0, **more):
    n = len(left)
    columns = {"time": np.arange(n) / 6.5, "curL": np.full(n, current), "curR": np.full(n, -current), "velL": left}
    columns |= {"velR": right, **more}
    rows = [",".join(str(v) for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]))
    return path


def test_constant_wheel_speeds_are_a_circle():
    t = np.arange(0.0, 60.0, 0.15)
    x, y, heading = integrate(t, np.full(t.size, 0.6), np.full(t.size, 0.4), track_m=1.0)
    # v = 0.5 m/s and 0.2 rad/s to the right: a circle of 2.5 m about (2.5, 0)
    np.testing.assert_allclose(heading, 0.2 * t)
    np.testing.assert_allclose(np.hypot(x - 2.5, y), 2.5, rtol=1e-12)
    np.testing.assert_allclose(x, 2.5 - 2.5 * np.cos(0.2 * t), atol=1e-9)


def test_nothing_is_driven_over_a_gap_or_back_in_time():
    t = np.array([0.0, 0.5, 30.0, 30.5, 30.2, 30.7])
    _, y, _ = integrate(t, np.full(6, 1.0), np.full(6, 1.0), track_m=1.0)
    np.testing.assert_allclose(y, [0.0, 0.5, 0.5, 1.0, 1.0, 1.5])


def test_turns_on_the_spot_are_rolled_and_missing_rows_are_not(tmp_path):
    # 199 steps of 1 / 6.5 s at 0.5 m/s on both sides; the last row comes an hour late
    file = write(tmp_path / "a.csv", np.full(201, 0.5), np.full(201, -0.5), time=np.r_[np.arange(200) / 6.5, 3600.0])
    assert rolled_m(read_run(file, odometry=Odometry(1.0))) == pytest.approx(199 / 6.5 * 0.5)


def test_a_straight_log_becomes_a_run_for_the_segments(tmp_path):
    file = write(tmp_path / "snow_00.csv", np.full(200, 0.5), np.full(200, 0.5))
    run = read_run(file, odometry=Odometry(1.0, terrain_from_name=True))
    segments = cut_segments(run, charge=True)
    travelled = cut_travel(run, charge=True)
    for each in (segments, travelled):
        assert len(each) == 15
        np.testing.assert_allclose(each.driven_m, 0.5 * 199 / 6.5 / 15, rtol=1e-3)  # 199 steps at 6.5 Hz are 15.3 m
        np.testing.assert_allclose(each.energy_j, 6.0 * 199 / 6.5 / 15, rtol=1e-3)  # both magnitudes
        np.testing.assert_allclose(each.turned_abs_rad, 0.0, atol=1e-6)
        assert set(each.texts["terrain"]) == {"snow"}
    ground = flat_heightmap([run])
    assert np.isfinite(ground.sample(travelled.x, travelled.y)).all()
    assert (ground.heights == 0).all()


def test_turning_on_the_spot_is_wheel_travel(tmp_path):
    run = read_run(write(tmp_path / "ice.csv", np.full(200, 0.2), np.full(200, -0.2)), odometry=Odometry(0.8))
    assert np.nanmax(np.abs(run.x)) == 0.0
    segments = cut_travel(run, charge=True)
    assert len(segments) == 6  # 30.6 s at 0.2 m/s
    each_s = 199 / 6.5 / 6
    np.testing.assert_allclose(segments.heading_change_rad, 0.4 / 0.8 * each_s, rtol=1e-6)
    np.testing.assert_allclose(segments.energy_j, 6.0 * each_s, rtol=1e-6)
    np.testing.assert_array_equal(segments.standing_s, 0.0)
    np.testing.assert_allclose(segments.extras["speed"], 0.0, atol=1e-12)


def test_jitter_of_wheel_speeds_is_no_turning_and_no_turn_is_lost(tmp_path):
    """20 m straight on with speeds in steps of 0.01 m/s; and a turn on the spot right after a stop."""
    jitter = np.random.default_rng(3).choice([-0.01, 0.0, 0.01], (2, 260))
    straight = cut_travel(read_run(write(tmp_path / "a.csv", *(0.5 + jitter)), odometry=Odometry(1.0)), charge=True)
    raw = np.abs(np.diff(integrate(np.arange(260) / 6.5, *(0.5 + jitter), track_m=1.0)[2])).sum()
    assert straight.turned_abs_rad.sum() < 0.5 * raw

    speed = np.r_[np.zeros(30), np.full(10, 0.52), np.full(20, 0.5), np.zeros(30)]
    other = np.r_[np.zeros(30), np.full(10, -0.52), np.full(20, 0.5), np.zeros(30)]
    turn = cut_travel(read_run(write(tmp_path / "b.csv", speed, other), odometry=Odometry(1.0)), charge=True)
    assert turn.turned_abs_rad.sum() == pytest.approx(1.04 * 10 / 6.5, rel=1e-3)


def test_energy_is_integrated_where_a_voltage_was_logged(tmp_path):
    straight = np.full(200, 0.5)
    run = read_run(write(tmp_path / "a.csv", straight, straight, voltage=np.full(200, 24.0)), odometry=Odometry(1.0))
    segments = cut_travel(run)
    assert not segments.charge
    np.testing.assert_allclose(segments.energy_j, 24.0 * 6.0 * 199 / 6.5 / 15, rtol=1e-6)
    with pytest.raises(RunsError, match="no voltage"):
        cut_travel(read_run(write(tmp_path / "b.csv", straight, straight), odometry=Odometry(1.0)))


def test_the_ground_is_read_from_a_name():
    names = {"snow_02.csv": "snow", "sandy_loam_10.csv": "sandy_loam", "ice.csv": "ice", "07.csv": None}
    assert {name: terrain_in_name(name) for name in names} == names


def test_a_long_stop_is_in_no_segment_and_a_short_one_is(tmp_path):
    for seconds, stops in ((4.6, 1), (1.5, 0)):
        speed = np.concatenate([np.full(45, 0.5), np.zeros(round(6.5 * seconds)), np.full(45, 0.5)])
        segments = cut_travel(read_run(write(tmp_path / "a.csv", speed, speed), odometry=Odometry(1.0)), charge=True)
        assert len(segments) == 7  # 6.85 m, the fourth with the stop in its middle
        assert segments.used_m == pytest.approx(segments.track_m) == pytest.approx(0.5 * 89 / 6.5)
        assert segments.left_out.get("stops", 0) == len(segments.stationary) == stops
        longer = segments.duration_s.max() - np.median(segments.duration_s)
        assert longer == pytest.approx(0.0 if stops else seconds, abs=0.35)
        assert segments.standing_s.sum() == pytest.approx(0.0 if stops else seconds, abs=0.2)
        np.testing.assert_allclose(segments.energy_j, 6.0 * segments.duration_s)


def test_nothing_is_said_of_missing_rows(tmp_path):
    speed = np.full(200, 0.5)
    file = write(tmp_path / "a.csv", speed, speed)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:100] + lines[130:]))  # 31 steps of 0.154 s are 2.38 m
    segments = cut_travel(read_run(file, odometry=Odometry(1.0)), charge=True)
    assert segments.left_out == {"gaps": 1}
    assert segments.left_out_m["gaps"] == pytest.approx(0.5 * 31 / 6.5)
    assert segments.used_m + segments.left_out_m["gaps"] == pytest.approx(segments.track_m)


def test_what_is_missing_is_named(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("time,velL,curL,curR\n" + "\n".join(f"{k},1,1,1" for k in range(9)))
    with pytest.raises(RunsError, match="'speed_right'"):
        read_run(file, odometry=Odometry(1.0))
    with pytest.raises(InputError, match="track"):
        Odometry(0.0)
    with pytest.raises(InputError, match="no run"):
        flat_heightmap([])


def test_the_husky_turns_dearer_on_loam_than_on_ice(real_data):
    def charge_per_s(name):
        run = read_run(real_data / "husky" / f"{name}.csv", odometry=Odometry(HUSKY_TRACK_M))
        segments = cut_travel(run, charge=True)
        return len(segments), float(segments.energy_j.sum() / segments.duration_s.sum())

    # the data's README: sandy loam about 22 A turning and 7.7 A straight, ice 6.4 and 4.9 A
    assert charge_per_s("sandy_loam_10")[1] == pytest.approx(22.0, rel=0.15)
    assert charge_per_s("ice_08")[1] == pytest.approx(7.0, rel=0.15)
    count, straight = charge_per_s("sandy_loam_12")
    assert count > 10
    assert straight == pytest.approx(7.7, rel=0.2)


def test_real_odometry_is_metres_long(real_data):
    run = read_run(real_data / "husky" / "mixed_00.csv", odometry=Odometry(HUSKY_TRACK_M))
    assert {"SNOW", "ASPHALT", "FLOORING"} <= set(run.texts["terrain"])
    segments = cut_travel(run, charge=True)
    assert len(segments) == pytest.approx(250, abs=30)
    assert segments.used_m == pytest.approx(len(segments), rel=0.01)
    assert segments.used_m >= 0.99 * segments.track_m
