"""The Gaussian process over the map: what it must say where friction is uniform, patchy, or was never measured."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.model.errors import InputError
from tests.paper.friction_map import FrictionMap

WEIGHT_N = 350.0


def test_it_finds_a_patch_and_returns_to_the_mean_far_away() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 30, (2, 400))
    grade = 0.05 * rng.standard_normal(400)
    mu = 0.08 + 0.04 * np.exp(-((x - 10) ** 2 + (y - 10) ** 2) / 18)
    traction = WEIGHT_N * (mu + grade + 0.005 * rng.standard_normal(400))
    found = FrictionMap.fit(x, y, traction, grade, weight_n=WEIGHT_N)
    here, there, far = found.rolling_resistance([10.0, 25.0, 3000.0], [10.0, 25.0, 3000.0])
    assert here == pytest.approx(0.12, abs=0.01)  # a smooth process rounds the peak off
    assert there == pytest.approx(0.08, abs=0.005)
    assert far == pytest.approx(found.mean, abs=1e-6)  # of a stationary process far from its data
    assert found.mean == pytest.approx((traction / WEIGHT_N - grade).mean())


def test_too_few_segments_are_refused() -> None:
    with pytest.raises(InputError, match="at least 5"):
        FrictionMap.fit([1, 2], [1, 2], [30, 30], [0, np.nan], weight_n=WEIGHT_N)
