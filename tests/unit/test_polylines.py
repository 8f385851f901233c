"""The shape of polylines: equal parts, whatever rounding does to them."""

import numpy as np
import pytest

from joulemap.planner.pricing.polylines import path_length, subdivided


@pytest.mark.parametrize("seed", range(5))
def test_a_line_that_is_cut_into_parts_keeps_its_vertices_and_its_length(seed):
    line = np.random.default_rng(seed).uniform(0.0, 50.0, (12, 2))
    parts = subdivided(line, 0.3)
    assert np.hypot(*np.diff(parts, axis=0).T).max() <= 0.3 + 1e-9
    assert path_length(parts) == pytest.approx(path_length(line), rel=1e-12)
    assert set(map(tuple, line)) <= set(map(tuple, parts))


@pytest.mark.parametrize("shift", [0.0, 1e-12, -1e-12])
def test_rounding_adds_no_part(shift):
    line = np.array([(0.1, 0.0), (0.1, 3.0 + shift), (4.1 + shift, 3.0 + shift)])
    parts = subdivided(line, 1.0)
    assert len(parts) == 8
    assert path_length(parts) == pytest.approx(7.0)


def test_a_single_point_stays():
    np.testing.assert_array_equal(subdivided(np.array([(3.0, 4.0)]), 1.0), [(3.0, 4.0)])
