"""Equation 5 and its predictor: closed forms on planes, parity of lattice and segments, the baseline fits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.physics import (
    PhysicsPredictor,
    eq5_traction_per_m,
    fit_rolling_resistance,
)
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import GRAVITY_MPS2, Robot
from joulemap.model.terrain.heightmap import Heightmap

ROBOT = Robot(mass_kg=40.0, rolling_resistance=0.1)


def plane(rise_east: float, rise_north: float, *, resolution_m: float = 0.25, cells: int = 24) -> Heightmap:
    frame = GridFrame(10.0, 50.0, resolution_m, cells, cells)
    x, y = frame.centres()
    return Heightmap(
        (7.0 + rise_east * (x - 10.0)[None, :] + rise_north * (y - 44.0)[:, None]).astype(np.float32), frame
    )


def test_per_horizontal_metre_is_the_printed_equation_over_its_surface_length():
    pitch = np.radians([-20.0, -3.0, 0.0, 5.0, 30.0])
    printed = 343.0 * (0.08 * np.cos(pitch) + np.sin(pitch)) / np.cos(pitch)  # m g (mu cos theta + sin theta) d
    assert eq5_traction_per_m(343.0, 0.08, np.tan(pitch)) == pytest.approx(printed, rel=1e-12)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.sampled_from([0.05, 0.1, 0.25, 1.0]), st.integers(4, 33))
@settings(max_examples=25, deadline=None)
def test_exact_on_planes_for_every_heading(rise_east, rise_north, resolution_m, count):
    # closed form: the grade along h is the gradient times (sin h, cos h); science.md, section 4
    heightmap = plane(rise_east, rise_north, resolution_m=resolution_m, cells=max(int(6 / resolution_m), 6))
    headings = heading_bins(count)
    frame = heightmap.frame.respaced(1.0)
    got = PhysicsPredictor().traction_per_m(heightmap, ROBOT, frame, headings)
    grade = rise_east * np.sin(headings) + rise_north * np.cos(headings)
    expected = 40.0 * GRAVITY_MPS2 * (0.1 + grade)
    assert got.dtype == np.float32
    assert got.shape == (*frame.shape, count)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), atol=2e-3)


def test_lattice_and_segments_agree_and_antipodes_mirror():
    rng = np.random.default_rng(3)
    frame = GridFrame(0.0, 12.0, 0.2, 60, 55)
    heightmap = Heightmap(rng.normal(300.0, 0.2, frame.shape).astype(np.float32), frame)
    cells = heightmap.frame.respaced(1.0)
    headings = heading_bins(16)
    physics = PhysicsPredictor()
    lattice = physics.traction_per_m(heightmap, ROBOT, cells, headings)
    x, y = cells.centres()
    at = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    segments = physics.segment_traction(heightmap, ROBOT, *(a.ravel() for a in at)).reshape(lattice.shape)
    np.testing.assert_allclose(lattice, segments, rtol=2e-6, atol=1e-4)
    rolling = ROBOT.weight_n * ROBOT.rolling_resistance
    np.testing.assert_allclose(lattice[..., 8:] - rolling, rolling - lattice[..., :8], atol=1e-3)
    part = physics.traction_per_m(heightmap, ROBOT, cells.window(3, 7, 2, 9), headings)
    np.testing.assert_array_equal(part, lattice[3:7, 2:9])


def test_unknown_ground_is_not_priced():
    heightmap = plane(0.1, 0.0)
    heights = heightmap.heights.copy()
    heights[10:12, 10:12] = np.nan
    holed = Heightmap(heights, heightmap.frame)
    lattice = PhysicsPredictor().traction_per_m(holed, ROBOT, holed.frame.respaced(1.0), heading_bins(8))
    assert np.isnan(lattice[2, 2]).any()
    assert np.isfinite(lattice[0, 0]).all()
    assert math.isnan(float(tan_grade(holed, 9.0, 47.0, 0.0)))  # outside the map


def test_least_squares_finds_the_friction_that_made_the_data():
    rng = np.random.default_rng(0)
    grade = rng.normal(0.0, 0.05, 400)
    traction = eq5_traction_per_m(300.0, 0.07, grade)
    assert fit_rolling_resistance(traction, grade, weight_n=300.0) == pytest.approx(0.07, rel=1e-12)
    noisy = traction + rng.normal(0.0, 5.0, 400)
    mu = fit_rolling_resistance(noisy, grade, weight_n=300.0)
    rest = [np.sum((noisy - eq5_traction_per_m(300.0, mu + d, grade)) ** 2) for d in (-1e-4, 0.0, 1e-4)]
    assert rest[1] == min(rest)
    with pytest.raises(InputError, match="no segment"):
        fit_rolling_resistance([np.nan], [0.0], weight_n=300.0)
