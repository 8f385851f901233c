"""Noise of a survey: estimated from the heights alone, taken out, and what stands out of it kept."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import HeightmapError
from joulemap.model.field.sites import random_site
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.denoising import LEAST_NOISE_M, _details, denoised, margin_cells, noise_shares
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.terrain.windows import window_without_noise
from joulemap.model.terrain.writers import write_geotiff
from joulemap.model.training.simulated_set import smooth_site
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.limits import ground_limits, noise_warnings
from joulemap.service.library.heightmaps import read_heightmap

ROBOT = Robot()


def surveys(cells_m, *, smooth, seed=3):
    """A simulated ground surveyed without noise, and the generator of its noise."""
    rng = np.random.default_rng(seed)
    site = smooth_site(rng) if smooth else random_site(rng, max_slope_deg=20.0)
    return degrade(site.terrain, SurveyQuality(cells_m), rng=rng), rng


def noisy(clean, noise_m, rng):
    return replace(clean, heights=(clean.heights + noise_m * rng.standard_normal(clean.frame.shape)).astype(np.float32))


@pytest.mark.parametrize(
    ("smooth", "cells_m", "noise_m"), [(True, 0.1, 0.01), (True, 0.25, 0.15), (False, 0.1, 0.05), (False, 0.25, 0.01)]
)
def test_the_noise_is_estimated_from_the_heights_alone(smooth, cells_m, noise_m):
    clean, rng = surveys(cells_m, smooth=smooth)
    assert noisy(clean, noise_m, rng).noise_m == pytest.approx(noise_m, rel=0.12, abs=0.003)


@pytest.mark.parametrize(
    ("smooth", "cells_m", "noise_m"), [(True, 0.1, 0.03), (False, 0.1, 0.15), (True, 0.25, 0.05), (False, 1.0, 0.15)]
)
def test_most_of_the_noise_goes_and_the_ground_stays(smooth, cells_m, noise_m):
    clean, rng = surveys(cells_m, smooth=smooth)
    ground = noisy(clean, noise_m, rng).without_noise
    assert np.std(ground.heights - clean.heights) < 0.5 * noise_m
    assert np.std(clean.without_noise.heights - clean.heights) < 0.004


def test_shares_of_independent_noise_are_the_published_ones():
    """Starck & Murtagh 2006, table of the B3 spline wavelet: 0.890, 0.201, 0.086."""
    assert noise_shares(0.0) == pytest.approx((0.890, 0.201, 0.086), abs=1e-3)
    assert noise_shares(1e-3) == pytest.approx(noise_shares(0.0), abs=3e-4)


@pytest.mark.parametrize("length_cells", [1.0, 2.0, 5.0])
def test_shares_of_noise_with_a_length_are_those_of_drawn_noise(length_cells):
    shape = (800, 800)
    noise = gaussian_filter(np.random.default_rng(7).standard_normal(shape), length_cells / np.sqrt(2.0), mode="wrap")
    noise = (noise / noise.std()).astype(np.float32)
    count = len(noise_shares(length_cells))
    details = _details(noise, np.ones(shape, np.float32), count)[0]
    assert [detail.std() for detail in details] == pytest.approx(noise_shares(length_cells), rel=0.08, abs=0.002)


@pytest.mark.parametrize("smooth", [True, False])
def test_noise_that_is_alike_over_some_cells_goes_where_it_is_told(smooth):
    clean, rng = surveys(0.25, smooth=smooth)
    noise = gaussian_filter(rng.standard_normal(clean.frame.shape), 2.0 / np.sqrt(2.0), mode="wrap")
    survey = replace(clean, heights=(clean.heights + 0.05 / noise.std() * noise).astype(np.float32))
    as_given = replace(survey, given_noise_m=0.05, given_noise_length_m=0.5).without_noise

    def _twists(ground):
        """Of squares of two cells, of the error: what wheels feel of it."""
        error = ground.heights - clean.heights
        return np.std(error[2:, 2:] - error[2:, :-2] - error[:-2, 2:] + error[:-2, :-2])

    assert _twists(survey.without_noise) < 0.6 * _twists(survey)  # by the map alone most of it is seen
    assert _twists(as_given) < 0.7 * _twists(survey)
    assert as_given.removed_noise_m < 0.4 * 0.05  # it hides less of the finest details than independent noise


@pytest.mark.parametrize("rms_m", [0.02, 0.1])
@pytest.mark.parametrize("power", [2.0, 3.0])
def test_self_affine_ground_is_no_noise_and_noise_on_it_is(power, rms_m):
    rng = np.random.default_rng(9)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(400), np.fft.fftfreq(400)))
    frequency[0, 0] = np.inf
    ground = np.fft.ifft2(np.fft.fft2(rng.standard_normal((400, 400))) * frequency ** (-0.5 * (power + 1.0))).real
    ground = (rms_m / ground.std() * ground)[:200, :200]
    noise = gaussian_filter(rng.standard_normal(ground.shape), 1.5 / np.sqrt(2.0), mode="wrap")
    frame = GridFrame(0.0, 40.0, 0.2, 200, 200)
    assert Heightmap(ground.astype(np.float32), frame).noise.bumps is None
    bumps = Heightmap((ground + 0.03 / noise.std() * noise).astype(np.float32), frame).noise.bumps
    assert bumps.std_m == pytest.approx(0.03, rel=0.1)
    assert bumps.length_m == pytest.approx(0.3, rel=0.1)
    assert bumps.probability > 0.5


def test_without_noise_nothing_is_changed():
    plane = Heightmap(np.add.outer(0.1 * np.arange(60), 0.2 * np.arange(50)), GridFrame(0.0, 30.0, 0.5, 60, 50))
    assert plane.noise_m < LEAST_NOISE_M
    assert plane.without_noise is plane
    rough = noisy(plane, 0.05, np.random.default_rng(0))
    np.testing.assert_array_equal(replace(rough, given_noise_m=0.0).without_noise.heights, rough.heights)


def test_energies_hardly_depend_on_the_noise():
    clean, rng = surveys(0.25, smooth=True)
    model = load_predictor("default")

    def mean_j(ground):
        robot = replace(ROBOT, wheel_radius_m=0.3)  # no bump of the noise is a step to it
        return np.nanmean(np.maximum(build_lattice(ground, robot, model, headings=8).traction_per_m, 0.0))

    survey = noisy(clean, 0.05, rng)
    assert mean_j(replace(survey, given_noise_m=0.0)) > 1.5 * mean_j(clean)  # what it was
    assert (
        mean_j(clean) < mean_j(survey) < 1.3 * mean_j(clean)
    )  # bumps that noise hides are expected, as they usually are


@pytest.mark.parametrize(
    ("cells_m", "inside", "angle_deg"), [(0.1, 0.5, 0.0), (0.2, 0.0, 0.0), (0.2, 0.5, 0.0), (0.2, 0.3, 20.0)]
)
def test_a_kerb_that_is_five_times_the_noise_stays_and_noise_is_none(cells_m, inside, angle_deg):
    count, step_m = round(40.0 / cells_m), 1.5 * ROBOT.wheel_radius_m
    frame = GridFrame(0.0, 40.0, cells_m, count, count)
    x, y = np.meshgrid(*frame.centres())
    angle = np.radians(angle_deg)
    beyond = (x - 20.4 - inside * cells_m) * np.cos(angle) + (y - 20.0) * np.sin(angle)
    heights = step_m * np.clip(0.5 + beyond / cells_m, 0.0, 1.0) + np.sin(x / 9.0)
    survey = Heightmap(heights + 0.2 * step_m * np.random.default_rng(1).standard_normal(x.shape), frame)
    cells = frame.respaced(1.0)
    beside = ground_limits(survey.without_noise, cells, ROBOT)[4][1:-1, 1:-1]
    x, y = (at[1:-1, 1:-1] for at in np.meshgrid(*cells.centres()))
    away_m = np.abs((x - 20.4 - inside * cells_m) * np.cos(angle) + (y - 20.0) * np.sin(angle))
    assert beside[away_m < 0.3].mean() >= 0.95
    assert beside[away_m > 2.0].mean() < 0.01


def test_a_step_as_long_as_a_stone_is_not_made_longer():
    """A block of three cells a side stands out of the noise by itself; cells beside it on the same lines stay low."""
    heights = np.zeros((60, 60))
    heights[30:33, 30:33] = 0.5
    noise = 0.02 * np.random.default_rng(2).standard_normal(heights.shape)
    found = denoised((heights + noise).astype(np.float32), 0.02)
    assert found[30:33, 30:33].min() > 0.4
    assert np.abs(np.where(heights > 0.0, 0.0, found)).max() < 0.1


def test_unknown_heights_stay_unknown_and_change_little_around_them():
    clean, rng = surveys(0.1, smooth=False)
    survey = noisy(clean, 0.05, rng)
    holes = survey.heights.copy()
    holes[100:130, 40:90] = np.nan
    found = denoised(holes, 0.05)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(holes))
    known = ~np.isnan(holes)
    assert np.abs(found - denoised(survey.heights, 0.05))[known].max() < 0.05
    assert replace(survey, heights=holes).noise_m == pytest.approx(survey.noise_m, rel=0.05)


@pytest.mark.parametrize("length_m", [0.0, 0.3])
def test_windows_of_a_file_are_those_of_the_whole_map(tmp_path, length_m):
    clean, rng = surveys(0.1, smooth=False)
    survey = noisy(clean, 0.05, rng)
    if length_m:
        noise = gaussian_filter(rng.standard_normal(clean.frame.shape), length_m / 0.1 / np.sqrt(2.0), mode="wrap")
        survey = replace(clean, heights=(clean.heights + 0.1 / noise.std() * noise).astype(np.float32))
    path = tmp_path / "dem.tif"
    write_geotiff(path, survey)
    whole, file = read_heightmap(path).without_noise.heights, open_ground(path)
    for place in ((0, 60, 0, 70), (100, 180, 210, 300), (40 + margin_cells(0.0), 120, 3, 90)):
        row0, row1, col0, col1 = place
        part = window_without_noise(file, *place)
        np.testing.assert_allclose(part.heights, whole[row0:row1, col0:col1], atol=1e-5)
        assert (part.removed_noise_m == file.noise_m) == (file.noise_length_m == 0.0)


def test_noise_that_is_told_counts(tmp_path):
    clean, rng = surveys(0.1, smooth=True)
    path = tmp_path / "dem.tif"
    write_geotiff(path, noisy(clean, 0.05, rng))
    assert open_ground(path, noise_m=0.02).noise_m == 0.02
    assert read_heightmap(path, noise_m=0.0).without_noise.noise_m == 0.0
    with pytest.raises(HeightmapError, match=r"noise of a survey, must lie in 0\.\.10 m, got -1"):
        read_heightmap(path, noise_m=-1.0)


def test_what_noise_hides_is_said():
    assert noise_warnings(0.001, ROBOT) == []
    few, many = noise_warnings(0.01, ROBOT)[0], noise_warnings(0.05, ROBOT)[0]
    assert "about 10 mm" in few
    assert "may be hidden" not in few
    assert "Steps of up to 0.38 m may be hidden, more than the wheel radius of 0.127 m" in many
