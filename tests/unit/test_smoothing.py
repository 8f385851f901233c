"""Smoothing of a track: within its pieces, whatever the rate of the fixes."""

import numpy as np

from joulemap.model.runs.smoothing import smooth


def test_smoothing_never_crosses_pieces_and_takes_some_of_many_rows():
    slow, piece = 0.1 * np.arange(50), np.repeat([1, 2], 25)
    bent = np.where(piece == 1, 2.0 * slow, 7.0)
    x, _, speed, _ = smooth(slow, bent, slow, piece, 0.3)
    np.testing.assert_allclose(x, bent, atol=1e-12)
    np.testing.assert_allclose(speed, np.where(piece == 1, 2.0, 0.0), atol=1e-9)
    line = np.linspace(0.0, 1.0, 30_000)
    noisy = line + 0.1 * np.random.default_rng(1).standard_normal(line.size)
    dense, *_ = smooth(3.0 * line, noisy, noisy, np.ones(line.size, dtype=np.int64), 0.1)
    assert np.abs(dense - line)[1_000:-1_000].mean() < 0.01  # of 6,000 rows that near in time every seventh is enough
