"""Cutting segments: exact answers on lines, circles and interrupted drives."""

import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.drive import describe_segments
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.reader import Run
from joulemap.model.runs.segments import concatenate, driven_only
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
    assert len(segments) == 29  # 29.95 m
    np.testing.assert_allclose(segments.energy_j, 28.0 * 2.0 * 2.0, rtol=1e-9)  # 56 W for 2 s
    np.testing.assert_allclose(segments.duration_s, 2.0, rtol=1e-9)
    np.testing.assert_allclose(segments.driven_m, 1.0, rtol=1e-9)
    np.testing.assert_allclose(segments.heading_rad, math.radians(30.0), atol=1e-9)
    np.testing.assert_allclose(segments.heading_change_rad, 0.0, atol=1e-9)
    s = 0.5 + np.arange(29)
    np.testing.assert_allclose(segments.x, 100 + s * 0.5, atol=1e-9)
    np.testing.assert_allclose(segments.y, 50 + s * math.cos(math.radians(30.0)), atol=1e-9)
    assert segments.left_out == {"remainders": 1}


def test_a_stand_counts_beside_segments_of_its_run_only():
    rest = np.full(100, 100.0), np.full(100, 50.0)
    runs = []
    for name in ("a", "b"):
        drive = line(name=name)
        x, y = (np.concatenate([start, along]) for start, along in zip(rest, (drive.x, drive.y), strict=True))
        amps = np.where(np.arange(x.size) < 100, 0.5, 2.0)
        runs.append(cut_segments(run_along(x, y, name=name, amps=amps, temperature=np.full(x.size, 12.0))))
    segments = concatenate(runs)
    assert {interval[0] for interval in segments.stationary} == {0, 1}
    ground = Heightmap(np.zeros((120, 120), np.float32), GridFrame(50.0, 130.0, 1.0, 120, 120))
    for some, runs_left in ((segments, {0, 1}), (segments.take(segments.run == 0), {0})):
        drive, measured = describe_segments(some, ground, Robot(), np.full(len(some), 30.0))
        assert set(drive.run[drive.standing]) == runs_left
        assert (drive.columns["temperature"] == 12.0).all()
        np.testing.assert_allclose(measured[drive.standing] / drive.duration_s[drive.standing], 14.0, rtol=0.02)


def test_rising_power_is_integrated_exactly():
    t = np.arange(600) / 10.0
    segments = cut_segments(replace(line(), current_a=1.0 + 0.05 * t, voltage_v=np.full(600, 20.0)))
    a, b = segments.t0, segments.t0 + segments.duration_s
    np.testing.assert_allclose(segments.energy_j, 20.0 * ((b - a) + 0.025 * (b**2 - a**2)), rtol=1e-9)


def test_a_circle_turns_and_is_longer_than_its_chords():
    radius = 3.0
    angle = 0.5 / radius * np.arange(0.0, 60.0, 0.1)  # clockwise from its northern point
    segments = cut_segments(run_along(radius * np.sin(angle), radius * np.cos(angle)))
    turn = 2.0 * math.asin(0.5 / radius)  # of a chord of 1 m
    inner = slice(1, -1)  # the ends of a track are smoothed from one side only
    np.testing.assert_allclose(segments.heading_change_rad[inner], turn, rtol=5e-3)
    np.testing.assert_allclose(segments.driven_m[inner], radius * turn, rtol=2e-3)
    np.testing.assert_allclose(np.hypot(segments.x, segments.y)[inner], math.sqrt(radius**2 - 0.25), rtol=5e-3)


def test_noise_of_a_centimetre_does_not_lengthen_the_track():
    run, rng = line(seconds=400.0), np.random.default_rng(0)
    noisy = replace(run, x=run.x + 0.01 * rng.standard_normal(len(run)), y=run.y + 0.01 * rng.standard_normal(len(run)))
    segments = cut_segments(noisy)
    assert segments.driven_m.mean() < 1.01
    assert segments.duration_s.mean() == pytest.approx(2.0, rel=2e-3)
    assert segments.duration_s.std() < 0.02


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
    np.testing.assert_allclose(segments.duration_s, 2.0, rtol=1e-6)
    assert len(segments) == 29


def test_standing_belongs_to_no_segment():
    s = np.concatenate([np.zeros(100), 0.05 * np.arange(200), np.full(150, 0.05 * 200), 10 + 0.05 * np.arange(200)])
    segments = cut_segments(run_along(0 * s, s))
    assert segments.left_out["stops"] == 2
    assert 16 <= len(segments) <= 19  # of 20 m
    assert segments.duration_s.max() < 3.0


def test_bent_segments_are_left_out():
    s = 0.05 * np.arange(161)  # 3.5 m north, then 4.5 m back on a parallel 0.2 m to the east
    x = np.where(s < 3.5, 0.0, 0.2)
    y = np.where(s < 3.5, s, 7.0 - s)
    segments = cut_segments(run_along(x, y))
    assert segments.left_out["bent"] == 1
    assert (segments.driven_m < 1.2).all()


def test_charge_for_logs_without_voltage():
    run = replace(line(), voltage_v=None)
    with pytest.raises(RunsError, match="no voltage"):
        cut_segments(run)
    segments = cut_segments(run, charge=True)
    assert segments.charge
    np.testing.assert_allclose(segments.energy_j, 4.0, rtol=1e-9)  # 2 A for 2 s


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
    together = concatenate([parts[0], bare, parts[2]])
    assert together.runs == ("r0", "r1", "r2")
    assert len(together) == sum(map(len, parts))
    assert together.left_out == {"remainders": 3}
    held = together.take(together.run == 1)
    assert set(held.run) == {1}
    assert held.runs == together.runs
    assert np.isnan(held.extras["z"]).all()
    np.testing.assert_array_equal(held.energy_j, parts[1].energy_j)
    with pytest.raises(InputError, match="charge"):
        concatenate([parts[0], cut_segments(line(), charge=True)])
    with pytest.raises(InputError, match="no segments"):
        concatenate([])


def test_segments_cannot_be_changed():
    segments = cut_segments(line())
    with pytest.raises(ValueError, match="read-only"):
        segments.x[0] = 0.0


def test_a_length_must_be_positive():
    with pytest.raises(InputError, match="positive"):
        cut_segments(line(), length_m=0.0)


def test_a_robot_that_is_carried_does_not_drive():
    t = np.arange(0.0, 60.0, 0.1)
    speed = np.where(t < 30.0, 0.5, 4.0)  # driven for half a minute, then carried at a run
    x = np.concatenate([[0.0], np.cumsum(speed[:-1] * 0.1)])
    run = Run("carried", t, x, np.zeros_like(x), np.where(t < 30.0, 3.0, 0.5), np.full_like(t, 24.0))
    driven = cut_segments(run, max_speed_mps=1.5)
    assert driven.left_out["fast"] == pytest.approx(119, abs=1)
    assert len(driven) == pytest.approx(15, abs=1)


def test_a_run_that_draws_nothing_was_not_driven():
    t = np.arange(0.0, 40.0, 0.1)

    def drawing(name: str, current_a: float) -> Run:
        return Run(name, t, 0.5 * t, np.zeros_like(t), np.full_like(t, current_a), np.full_like(t, 24.0))

    parts = [cut_segments(drawing(name, a)) for name, a in (("a", 3.0), ("b", 2.0), ("c", 0.3), ("d", 2.5))]
    found = driven_only(concatenate(parts))
    assert found.left_out["undriven"] == len(parts[2])
    assert set(found.run) == {0, 1, 3}
    assert found.runs == ("a", "b", "c", "d")
    assert len(driven_only(concatenate(parts[1:3]))) == len(parts[1]) + len(parts[2])  # two runs are too few
