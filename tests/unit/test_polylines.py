"""The shape of polylines: corners and equal parts, whatever rounding does to them."""

import math

import numpy as np
import pytest

from joulemap.planner.pricing.polylines import corners, distances_along, path_length, subdivided


@pytest.mark.parametrize("seed", range(5))
def test_corners_are_what_is_left_of_a_line_that_was_cut_into_parts(seed):
    line = np.random.default_rng(seed).uniform(0.0, 50.0, (12, 2))
    np.testing.assert_allclose(corners(subdivided(line, 0.3)), line, atol=1e-12)


def test_a_line_that_turns_back_keeps_its_end_there():
    there_and_back = np.array([(0.0, 0.0), (0.0, 2.0), (0.0, 5.0), (0.0, 1.0)])
    np.testing.assert_array_equal(corners(there_and_back), there_and_back[[0, 2, 3]])


def test_a_line_of_two_vertices_has_no_corner_between():
    line = np.array([(0.0, 0.0), (3.0, 4.0)])
    np.testing.assert_array_equal(corners(line), line)


@pytest.mark.parametrize("shift", [0.0, 1e-12, -1e-12])
def test_rounding_adds_no_part(shift):
    line = np.array([(0.1, 0.0), (0.1, 3.0 + shift), (4.1 + shift, 3.0 + shift)])
    parts = subdivided(line, 1.0)
    assert len(parts) == 8
    assert np.diff(distances_along(parts)).max() <= 1.0 + 1e-9
    assert path_length(parts) == pytest.approx(7.0)


def test_distances_along_end_with_the_length():
    line = np.array([(0.0, 0.0), (3.0, 4.0), (3.0, 5.0)])
    np.testing.assert_allclose(distances_along(line), [0.0, 5.0, 6.0])
    assert math.isclose(path_length(line), 6.0)
