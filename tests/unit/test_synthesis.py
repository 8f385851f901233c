"""Seeded terrains, their parts, and surveys of them."""

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage

from joulemap.model.errors import HeightmapError, InputError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain import landforms
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.terrain.synthesis import (
    HILLSIDE,
    PARK,
    SAMPLE_GOAL,
    SAMPLE_START,
    TerrainRecipe,
    make_terrain,
    sample_terrain,
)

FIELD = TerrainRecipe(max_slope_deg=4.0, roughness_rms_m=0.01, furrow_depth_m=0.08, track_count=4)  # ploughed
SITE = GridFrame(west_m=0.0, north_m=40.0, resolution_m=0.1, rows=400, cols=600)


def slopes_deg(heightmap: Heightmap) -> np.ndarray:
    return np.rad2deg(np.arctan(np.hypot(*np.gradient(heightmap.heights, heightmap.resolution_m))))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_same_seed_gives_the_same_terrain_in_another_process() -> None:
    code = (
        "import numpy as np; from joulemap.model.frames import GridFrame;"
        "from joulemap.model.terrain.synthesis import *;"
        "frame = GridFrame(0.0, 40.0, 0.1, 400, 600);"
        f"print(*(make_terrain(r, frame, np.random.default_rng(5)).data_hash for r in (PARK, HILLSIDE, {FIELD})))"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    here = [make_terrain(recipe, SITE, rng(5)) for recipe in (PARK, HILLSIDE, FIELD)]
    assert [heightmap.data_hash for heightmap in here] == there
    assert make_terrain(PARK, SITE, rng(6)).data_hash not in there
    assert not any(np.isnan(heightmap.heights).any() for heightmap in here)


@pytest.mark.parametrize(("max_slope_deg", "tilt_deg"), [(5.0, 0.0), (30.0, 0.0), (30.0, 14.0), (12.0, 11.9)])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_steepest_slope_is_what_the_recipe_says(max_slope_deg: float, tilt_deg: float, seed: int) -> None:
    recipe = TerrainRecipe(
        max_slope_deg=max_slope_deg,
        tilt_deg=tilt_deg,
        tilt_heading_deg=210.0,
        relief_shortest_m=10.0,
        roughness_rms_m=0.0,
    )
    slopes = slopes_deg(make_terrain(recipe, SITE, rng(seed)))
    assert slopes.max() == pytest.approx(max_slope_deg, rel=0.01)


def test_fractal_has_its_rms_and_its_spectrum() -> None:
    frame = GridFrame(0.0, 256.0, 0.5, 512, 512)
    surface = landforms.fractal(frame, rng(), exponent=3.0, rms_m=0.2, longest_m=20.0)
    assert surface.std() == pytest.approx(0.2, rel=0.15)
    window = np.hanning(512)[:, None] * np.hanning(512)[None, :]
    power = np.abs(np.fft.fft2(surface * window)) ** 2
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(512, 0.5), np.fft.fftfreq(512, 0.5)))
    edges = np.geomspace(0.1, 0.8, 9)
    means = [power[(k >= a) & (k < b)].mean() for a, b in zip(edges[:-1], edges[1:], strict=True)]
    fitted = np.polyfit(np.log(np.sqrt(edges[:-1] * edges[1:])), np.log(means), 1)[0]
    assert fitted == pytest.approx(-3.0, abs=0.2)
    assert power[k < 1 / 40.0].mean() < 0.05 * power[(k > 1 / 20.0) & (k < 1 / 10.0)].mean()


def test_furrows_run_along_their_heading() -> None:
    furrows = landforms.furrows(SITE, rng(), depth_m=0.1, spacing_m=2.0, heading_rad=0.0)  # north-south
    assert np.ptp(furrows, axis=0).max() < 1e-6
    assert np.ptp(furrows) == pytest.approx(0.1, rel=0.01)
    np.testing.assert_allclose(furrows[:, 20:], furrows[:, :-20], atol=1e-5)  # 2 m farther east


def test_bumps_have_their_density_and_size() -> None:
    surface = landforms.bumps(SITE, rng(3), per_m2=0.05, height_m=0.1, radius_m=0.2)
    assert surface.min() >= 0.0
    peaks = (surface == ndimage.maximum_filter(surface, 9)) & (surface > 0.005)
    # Exponential heights: e^-0.05 of 120 bumps are over 5 mm; a few overlap. Three standard deviations of Poisson.
    assert peaks.sum() == pytest.approx(0.05 * 2400 * math.exp(-0.05), abs=33)
    # Volume of a Gaussian bump is 2 pi r^2 h; E[r^2] = 0.2^2 (1 + 1/12), E[h] = 0.1.
    volume = surface.sum() * SITE.resolution_m**2
    expected = 120 * math.tau * 0.04 * (13 / 12) * 0.1
    assert volume == pytest.approx(expected, rel=0.4)


def test_tracks_are_pairs_of_ruts() -> None:
    surface = landforms.tracks(SITE, rng(1), count=1, depth_m=0.08, gauge_m=1.5, width_m=0.3)
    assert surface.min() == pytest.approx(-0.08, rel=0.01)
    assert surface.max() <= 0.0
    assert ndimage.label(surface < -0.04)[1] == 2


@pytest.mark.parametrize(
    "values",
    [
        {"max_slope_deg": 61.0},
        {"tilt_deg": 6.0},
        {"furrow_spacing_m": 0.0},
        {"bumps_per_m2": -1.0},
        {"relief_longest_m": math.nan},
    ],
)
def test_impossible_recipes_are_refused_by_name(values: dict) -> None:
    with pytest.raises(InputError, match=next(iter(values))):
        TerrainRecipe(**values)


def test_the_sample_terrain_has_a_knoll_between_start_and_goal_and_a_pond() -> None:
    heightmap = sample_terrain()
    assert (heightmap.frame.shape, heightmap.resolution_m) == ((400, 400), 0.5)
    assert heightmap.data_hash == sample_terrain(7).data_hash
    x, y = np.linspace(SAMPLE_START, SAMPLE_GOAL, 200).T
    straight = heightmap.sample(x, y)
    assert straight.max() - max(straight[0], straight[-1]) > 12.0
    unknown = np.isnan(heightmap.heights)
    assert ndimage.label(unknown)[1] == 1
    assert 0.001 < unknown.mean() < 0.01


@pytest.mark.parametrize("resolution_m", [0.2, 0.25, 0.37, 1.0])
def test_a_survey_averages_over_its_cells(resolution_m: float) -> None:
    """The area mean of a plane is its value at the cell's centre. A fine cell shared by two coarse ones counts as
    level, which shifts the mean by up to slope x 0.1^2 / 8 / resolution.
    """
    whole = resolution_m in (0.2, 1.0)
    within_m = 1e-4 + (0.0 if whole else (0.3 + 0.1) * 0.1**2 / 8.0 / resolution_m)
    x, y = SITE.centres()
    plane = Heightmap(0.3 * x[None, :] + 0.1 * y[:, None] + 500.0, SITE)
    coarse = degrade(plane, SurveyQuality(resolution_m), rng=rng())
    cx, cy = coarse.frame.centres()
    np.testing.assert_allclose(coarse.heights, 0.3 * cx[None, :] + 0.1 * cy[:, None] + 500.0, rtol=0, atol=within_m)


def test_a_survey_keeps_the_mean_and_the_unknown() -> None:
    heights = make_terrain(PARK, SITE, rng()).heights.copy()
    heights[100:150, 200:300] = np.nan
    coarse = degrade(Heightmap(heights, SITE), SurveyQuality(1.0, smoothing_m=0.3), rng=rng())
    assert np.isnan(coarse.heights).sum() == 5 * 10
    assert np.isnan(coarse.heights[10:15, 20:30]).all()
    whole = degrade(make_terrain(PARK, SITE, rng()), SurveyQuality(1.0), rng=rng())
    block = make_terrain(PARK, SITE, rng()).heights.reshape(40, 10, 60, 10).mean(axis=(1, 3))
    np.testing.assert_allclose(whole.heights, block, atol=1e-6)


def test_survey_noise_and_smoothing_have_their_size() -> None:
    flat = Heightmap(np.zeros(SITE.shape), SITE)
    assert degrade(flat, SurveyQuality(0.2, noise_m=0.03), rng=rng()).heights.std() == pytest.approx(0.03, rel=0.03)
    x, _ = SITE.centres()
    wave = Heightmap(np.broadcast_to(np.sin(x * math.tau / 4.0), SITE.shape), SITE)  # 4 m long
    smooth = degrade(wave, SurveyQuality(0.1, smoothing_m=0.5), rng=rng())
    # A Gaussian of deviation s keeps exp(-(k s)^2 / 2) of a wave k.
    kept = math.exp(-0.5 * (math.tau / 4.0 * 0.5) ** 2)
    assert np.abs(smooth.heights[:, 50:-50]).max() == pytest.approx(kept, rel=0.01)


def test_a_survey_cannot_be_finer_than_the_terrain() -> None:
    with pytest.raises(HeightmapError, match="coarser"):
        degrade(make_terrain(PARK, SITE, rng()), SurveyQuality(0.05), rng=rng())
    with pytest.raises(HeightmapError, match="noise_m"):
        degrade(make_terrain(PARK, SITE, rng()), SurveyQuality(0.5, noise_m=-1.0), rng=rng())
