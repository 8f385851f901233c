"""Blanks of the position filled by wheel speeds: exact on arcs, refused where the wheels do not meet the fixes."""

import numpy as np
import pytest

from joulemap.model.runs.odometry import integrate
from joulemap.model.runs.reckoning import fill_by_wheels


def driven(radius_m=0.1, slip=1.0):
    """t, x, y, columns of a drive with a left turn in the middle; wheels in rad/s, turning less than they tell."""
    t = np.arange(0.0, 40.0, 0.05)
    turning = (t > 15.0) & (t < 25.0)
    left, right = np.where(turning, 0.7, 1.0), np.where(turning, 1.3, 1.0)
    x, y, heading = integrate(t, left, right, track_m=1.5)
    columns = {"wheel_left_rad_s": slip * left / radius_m, "wheel_right_rad_s": slip * right / radius_m}
    return t, x, y, columns | {"heading": np.degrees(heading) % 360.0}


def blanked(x, y, columns, rows):
    x, y, held = x.copy(), y.copy(), columns["heading"].copy()
    x[rows] = y[rows] = np.nan
    held[rows] = held[rows.start - 1]
    return x, y, columns | {"heading": held}


def test_a_turn_without_fixes_is_followed():
    t, x, y, columns = driven()
    rows = slice(300, 420)  # 6 s in the turn: 6 m
    bx, by, log = blanked(x, y, columns, rows)
    repairs = {}
    fx, fy = fill_by_wheels(t, bx, by, np.zeros(t.size, bool), log, repairs)
    assert repairs == {"reckoned_positions": 120}
    np.testing.assert_allclose(np.hypot(fx - x, fy - y), 0.0, atol=0.02)
    straight = np.interp(t, np.delete(t, rows), np.delete(x, rows))
    assert np.abs(straight - x).max() > 0.5  # what a straight line misses
    missed = (log["heading"] - columns["heading"] + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(missed, 0.0, atol=1.0)


def test_wheels_that_do_not_meet_the_fixes_are_not_believed():
    t, x, y, columns = driven()
    rows = slice(300, 420)
    bx, by, log = blanked(x, y, columns, rows)
    spinning = {key: v.copy() for key, v in log.items()}
    for key in ("wheel_left_rad_s", "wheel_right_rad_s"):
        spinning[key][rows] *= 2.0
    repairs = {}
    fx, _ = fill_by_wheels(t, bx, by, np.zeros(t.size, bool), spinning, repairs)
    assert repairs == {}
    assert np.isnan(fx[rows]).all()
    broken = np.zeros(t.size, bool)
    broken[rows.stop] = True
    assert np.isnan(fill_by_wheels(t, bx, by, broken, log, {})[0][rows]).all()
    bare = {"heading": log["heading"]}
    assert np.isnan(fill_by_wheels(t, bx, by, np.zeros(t.size, bool), bare, {})[0][rows]).all()


def test_the_warthogs_wheels_know_the_way_better_than_a_straight_line(real_data):
    from joulemap.model.runs.reader import read_run

    run = read_run(real_data / "drive" / "warthog_grass_2024-07-29.csv")
    known = np.isfinite(run.x)
    reckoned, straight = [], []
    for first in range(200, len(run) - 200, 60):  # three seconds without a fix
        x, y = run.x.copy(), run.y.copy()
        hidden = slice(first, first + 60)
        x[hidden] = y[hidden] = np.nan
        fx, fy = fill_by_wheels(run.t, x, y, run.breaks, dict(run.extras), {})
        at = np.flatnonzero(known[hidden]) + first
        if not at.size or np.isnan(fx[at]).any():
            continue
        left = np.isfinite(x)
        sx, sy = (np.interp(run.t[at], run.t[left], way[left]) for way in (x, y))
        straight.append(np.hypot(sx - run.x[at], sy - run.y[at]).max())
        reckoned.append(np.hypot(fx[at] - run.x[at], fy[at] - run.y[at]).max())
    assert len(reckoned) >= 10
    assert np.median(reckoned) < 0.6 * np.median(straight)
    assert np.quantile(reckoned, 0.9) == pytest.approx(0.2, abs=0.15)
