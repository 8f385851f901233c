"""A surface fitted to driven positions."""

import numpy as np
import pytest

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.surface_fit import fit_surface

EAST, NORTH = 500_000.0, 4_000_000.0


def lawnmower(width_m: float = 30.0, height_m: float = 20.0, lane_m: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions at 10 Hz and 0.5 m/s, up and down lanes: (x, y), each (n,)."""
    along = np.arange(0.0, height_m, 0.05)
    lanes = np.arange(0.0, width_m + 1e-9, lane_m)
    y = np.concatenate([along if k % 2 == 0 else along[::-1] for k in range(lanes.size)])
    return np.repeat(lanes, along.size) + EAST, y + NORTH


def park(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slopes within about 5 degrees, with waves down to 3 m."""
    u, v = x - EAST, y - NORTH
    return 310.0 + 0.03 * u + 0.6 * np.sin(u / 9.0) * np.cos(v / 7.0) + 0.015 * np.sin(u * 2.1 + 0.3) * np.cos(v * 2.0)


def errors(heightmap: Heightmap, margin_m: float = 0.0) -> np.ndarray:
    x, y = heightmap.frame.centres()
    inside = ((x > EAST + margin_m) & (x < EAST + 30.0 - margin_m))[None, :] & (
        (y > NORTH + margin_m) & (y < NORTH + 20.0 - margin_m)
    )[:, None]
    return (heightmap.heights - park(x[None, :], y[:, None]))[inside]


@pytest.fixture(scope="module")
def driven() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    x, y = lawnmower()
    x = x + rng.normal(0.0, 0.03, x.size)
    return x, y, park(x, y) + rng.normal(0.0, 0.01, x.size)


def test_driven_ground_is_recovered_within_the_noise_of_the_gps(driven: tuple) -> None:
    heightmap = fit_surface(*driven, crs="EPSG:32615")
    error = errors(heightmap)
    assert not np.isnan(error).any()
    assert np.sqrt(np.mean(error**2)) < 0.01  # 1 cm noise on each position
    assert np.abs(error).max() < 0.05
    assert heightmap.frame.crs == "EPSG:32615"
    assert heightmap.resolution_m == 0.1


def test_a_plane_is_recovered_exactly_and_continued() -> None:
    x, y = lawnmower(10.0, 10.0)
    heightmap = fit_surface(x, y, 100.0 + 0.1 * (x - EAST) - 0.3 * (y - NORTH))
    cx, cy = heightmap.frame.centres()
    exact = 100.0 + 0.1 * (cx - EAST)[None, :] - 0.3 * (cy - NORTH)[:, None]
    assert np.nanmax(np.abs(heightmap.heights - exact)) < 0.002


def test_ground_far_from_the_wheels_stays_unknown() -> None:
    x, y = lawnmower(20.0, 10.0)
    left = x < EAST + 5.0
    right = x > EAST + 15.0
    keep = left | right
    heightmap = fit_surface(x[keep], y[keep], park(x[keep], y[keep]), max_gap_m=0.8)
    cx, cy = heightmap.frame.centres()
    gap = np.abs(cx - (EAST + 10.0)) < 4.0
    assert np.isnan(heightmap.heights[:, gap]).all()
    beside = ((cx > EAST + 0.5) & (cx < EAST + 4.0))[None, :] & ((cy > NORTH + 0.5) & (cy < NORTH + 9.5))[:, None]
    assert not np.isnan(heightmap.heights[beside]).any()
    # One lane alone: known up to the gap on either side, 2 x 0.8 m wide.
    lane = fit_surface(x[left & (x < EAST + 0.5)], y[left & (x < EAST + 0.5)], y[x < EAST + 0.5], max_gap_m=0.8)
    assert (~np.isnan(lane.heights)).sum(axis=1).max() * 0.1 == pytest.approx(1.7, abs=0.11)


def test_standing_still_adds_no_weight(driven: tuple) -> None:
    x, y, z = driven
    rng = np.random.default_rng(0)
    # A minute of standing with the GPS off by 8 cm, 600 rows in one place.
    stood = [np.append(a, np.full(600, a[4000])) for a in (x, y)]
    heightmap = fit_surface(*stood, np.append(z, z[4000] + 0.08 + rng.normal(0, 0.005, 600)))
    assert abs(heightmap.sample(x[4000], y[4000]) - park(x[4000], y[4000])) < 0.03
    twice = fit_surface(*(np.tile(a, 2) for a in driven))
    once = fit_surface(*driven)
    np.testing.assert_allclose(twice.heights, once.heights, atol=1e-5)


def test_outliers_have_no_say(driven: tuple) -> None:
    x, y, z = driven
    rng = np.random.default_rng(1)
    bad = z.copy()
    spikes = rng.random(z.size) < 0.02
    bad[spikes] += rng.normal(0.0, 3.0, spikes.sum())
    for start in rng.integers(0, z.size - 50, 10):  # float fixes: four seconds on end, 0.4 m off
        bad[start : start + 40] += 0.4
    bad[::997] = np.nan
    error = errors(fit_surface(x, y, bad), margin_m=1.0)
    assert np.sqrt(np.nanmean(error**2)) < 0.02


@pytest.mark.parametrize(("smoothing_m", "kept"), [(1.0, 16 / 17), (2.0, 1 / 2), (4.0, 1 / 17)])
def test_smoothing_keeps_long_waves_and_drops_short_ones(smoothing_m: float, kept: float) -> None:
    """Closed form of a smoothing spline: 1 / (1 + (L / wavelength)^4); the knots take a little more."""
    x, y = lawnmower(12.0, 12.0, lane_m=0.1)
    heightmap = fit_surface(x, y, np.sin((x - EAST) * np.pi), smoothing_m=smoothing_m)  # waves of 2 m
    amplitude = np.abs(heightmap.heights[40:80, 40:80]).max()
    assert kept - 0.15 < amplitude < kept + 0.03


def test_too_few_points_or_too_wide_a_spread_is_refused() -> None:
    x, y = lawnmower(2.0, 2.0)
    with pytest.raises(HeightmapError, match="at least 12"):
        fit_surface(x[:5], y[:5], y[:5])
    with pytest.raises(HeightmapError, match="at least 12"):
        fit_surface(np.full(500, 3.0), np.full(500, 4.0), np.full(500, 5.0))
    x[7] = 0.0  # a row without a fix, 500 km away
    with pytest.raises(TooLargeError, match="far-off"):
        fit_surface(x, y, y)
    with pytest.raises(HeightmapError, match="smoothing_m"):
        fit_surface(x, y, y, smoothing_m=0.0)
