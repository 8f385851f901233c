"""The paper's chords: exact answers on lines and circles, and what they leave out."""

import math

import numpy as np

from tests.paper.chords import chords_of
from tests.unit.test_segments import circle, line, run_along


def test_chords_are_a_metre_each() -> None:
    segments = chords_of(line())
    assert len(segments) == 29  # 29.95 m
    np.testing.assert_allclose(segments.energy_j, 28.0 * 2.0 * 2.0, rtol=1e-9)  # 56 W for 2 s
    np.testing.assert_allclose(segments.driven_m, 1.0, rtol=1e-9)
    assert segments.left_out == {"remainders": 1}


def test_a_circle_turns_and_is_longer_than_its_chords() -> None:
    segments = chords_of(circle())
    turn = 2.0 * math.asin(0.5 / 3.0)  # of a chord of 1 m
    inner = slice(1, -1)  # the ends of a track are smoothed from one side only
    np.testing.assert_allclose(segments.heading_change_rad[inner], turn, rtol=5e-3)
    np.testing.assert_allclose(segments.driven_m[inner], 3.0 * turn, rtol=2e-3)
    np.testing.assert_allclose(np.hypot(segments.x, segments.y)[inner], math.sqrt(9.0 - 0.25), rtol=5e-3)


def test_what_a_chord_cannot_describe_is_left_out() -> None:
    s = 0.05 * np.arange(161)  # 3.5 m north, then 4.5 m back on a parallel 0.2 m to the east
    bent = run_along(np.where(s < 3.5, 0.0, 0.2), np.where(s < 3.5, s, 7.0 - s))
    assert chords_of(bent).left_out["bent"] == 1
    t = np.arange(0.0, 80.0, 0.1)
    way = np.where(t < 20.0, 0.5 * t, 10.0 + 0.1 * (t - 20.0))  # 10 m, and 6 m at a fifth of the speed
    assert chords_of(run_along(way, 0 * way)).left_out["slow"] >= 4
    fed_back = line(amps=np.where(np.arange(600) < 300, 2.0, -1.0))
    assert chords_of(fed_back).left_out["not_positive"] >= 13
    still = np.concatenate([s, np.full(40, s[-1]), s[-1] + s])  # 4 s: the next chord begins after them
    assert chords_of(run_along(still, 0 * still)).left_out["stops"] == 1
