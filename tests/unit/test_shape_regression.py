"""The regression on shape: its features on ground of known shape, and energies that it can express exactly."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.model.energy.shape_features import FEATURES, shape_features
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from tests.paper.ridge import RidgeBaseline

ROBOT = Robot(width_m=0.5)
FRAME = GridFrame(0.0, 12.0, 0.1, 120, 120)
EAST, NORTH = np.meshgrid(*FRAME.centres())


def of(heights: np.ndarray, heading_deg: float) -> dict[str, float]:
    """Features in the middle of the ground."""
    ground = Heightmap(heights.astype(np.float32), FRAME)
    values = shape_features(ground, ROBOT, 6.05, 6.05, np.radians(heading_deg))[0]
    return dict(zip(FEATURES, values, strict=True))


def test_a_plane_has_grades_and_nothing_else() -> None:
    found = of(0.05 * EAST + 0.1 * NORTH, 0.0)
    assert found["grade"] == pytest.approx(0.1, abs=1e-4)
    assert found["cross_grade"] == pytest.approx(0.05, abs=1e-4)
    assert found["track_climb"] == pytest.approx(0.14, abs=1e-4)  # all rises over 1.4 m
    assert of(0.05 * EAST + 0.1 * NORTH, 180.0)["grade"] == pytest.approx(-0.1, abs=1e-4)
    for name in ("roughness", "track_second_difference", "track_roughness", "curvature", "cross_curvature", "twist"):
        assert found[name] == pytest.approx(0.0, abs=2e-5), name


def test_a_trough_across_is_curved_along() -> None:
    found = of(0.2 * (NORTH - 6.05) ** 2, 0.0)
    assert found["curvature"] == pytest.approx(0.2, rel=1e-3)
    assert found["cross_curvature"] == pytest.approx(0.0, abs=1e-4)
    assert found["track_second_difference"] == pytest.approx(
        2 * 0.2 * 0.1**2, rel=1e-2
    )  # h'' of a parabola, times the step squared
    turned = of(0.2 * (NORTH - 6.05) ** 2, 90.0)
    assert turned["cross_curvature"] == pytest.approx(0.2, rel=0.05)  # at a few places only: bilinear chords
    assert turned["curvature"] == pytest.approx(0.0, abs=1e-4)


def test_an_energy_that_is_linear_in_the_grade_is_found_exactly() -> None:
    rng = np.random.default_rng(0)
    ground = Heightmap((0.3 * np.sin(EAST / 2) + 0.2 * np.cos(NORTH / 3)).astype(np.float32), FRAME)
    x, y = rng.uniform(2, 10, (2, 600))
    heading = rng.uniform(-np.pi, np.pi, 600)
    energy = 80.0 + 150.0 * shape_features(ground, ROBOT, x, y, heading)[:, 0]
    learned = slice(0, 400)
    model = RidgeBaseline.fit(
        ground, ROBOT, x[learned], y[learned], heading[learned], energy[learned], run=np.arange(400) // 100
    )
    predicted = model.predict_j(ground, ROBOT, x[400:], y[400:], heading[400:])
    np.testing.assert_allclose(predicted, energy[400:], rtol=5e-3)
    assert np.isnan(model.predict_j(ground, ROBOT, 0.1, 6.0, 0.0)).all()  # half of that segment lies off the map


def test_too_few_segments_are_refused() -> None:
    ground = Heightmap(np.zeros(FRAME.shape, dtype=np.float32), FRAME)
    with pytest.raises(InputError, match="at least 10"):
        RidgeBaseline.fit(ground, ROBOT, [6.0] * 4, [6.0] * 4, [0.0] * 4, [80.0] * 4)
