"""Named and random sites: the true terrain, the survey of it, and the ground it is made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import ndtri

from joulemap.model.errors import NotFoundError
from joulemap.model.field.robots import Ground
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.landforms import bumps, fractal
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.terrain.synthesis import TerrainRecipe, make_terrain

TRUE_RESOLUTION_M = 0.05
"""Cell of the true terrain [m]."""

_PARK = TerrainRecipe(max_slope_deg=5.0, roughness_rms_m=0.015, roughness_longest_m=5.0, roughness_exponent=4.0)

_SOIL_M = 0.25  # cell of the maps of rolling loss
_MARGIN_M = 1.6  # drives keep this far from the edge, so that no wheel leaves the terrain

GROUNDS: Mapping[str, Ground] = {
    "grass": Ground(),
    "soft_grass": Ground(name="grass", mu=0.072, bump_loss=0.95, patchiness=0.03),
    "dirt": Ground(
        name="dirt", mu=0.045, load_exponent=0.12, bump_loss=1.0, scrub=0.16, tpi_share=0.20, tussock_m=0.003
    ),
}


@dataclass(frozen=True)
class Site:
    """A place to drive."""

    name: str  # Name of the site
    terrain: Heightmap  # The true terrain, on cells of 5 cm
    survey: Heightmap  # The heightmap that a model is given
    ground: Ground  # What it is made of
    mu_factor: Heightmap  # Factor on the ground's rolling loss from place to place
    # The part of that factor which follows from the terrain, by its topographic position index
    mu_factor_explained: Heightmap
    words: tuple[str, str] = ("", "")  # What the operator calls the ground where `word_map` is below and above one half
    word_map: Heightmap | None = None  # Without it the whole site is called by the ground's name

    @property
    def drivable(self) -> tuple[float, float, float, float]:
        """West, south, east and north of the area in which waypoints may lie [m]."""
        west, south, east, north = self.terrain.frame.bounds
        return west + _MARGIN_M, south + _MARGIN_M, east - _MARGIN_M, north - _MARGIN_M

    def words_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.str_]:
        """Return what the operator calls the ground. `x`, `y`: world points [m], of any shape."""
        if self.word_map is None:
            return np.full(np.broadcast(x, y).shape, self.ground.name)
        return np.where(self.word_map.sample(x, y) < 0.5, *self.words)

    def with_words(self, words: tuple[str, str], rng: np.random.Generator) -> Site:
        """Return this site with two names for the ground, in areas of about 10 m; the ground itself is unchanged."""
        frame = self.mu_factor.frame
        noise = gaussian_filter(rng.standard_normal(frame.shape), 5.0 / _SOIL_M, mode="nearest")
        share = np.asarray(noise > np.quantile(noise, rng.uniform(0.35, 0.65)), dtype=np.float32)
        return replace(self, words=words, word_map=Heightmap(share, frame))

    def with_rolling_loss(self, factor: NDArray[np.float64]) -> Site:
        """Return this site with another rolling loss."""
        times = np.asarray(factor, dtype=np.float32)
        return replace(
            self,
            mu_factor=replace(self.mu_factor, heights=self.mu_factor.heights * times),
            mu_factor_explained=replace(self.mu_factor_explained, heights=self.mu_factor_explained.heights * times),
        )


@dataclass(frozen=True)
class Relief:
    """Shape of a terrain."""

    hills: TerrainRecipe = _PARK  # The large shape
    rough_m: float = 0.010  # Root mean square height of waves of 0.1 to 1.2 m [m]
    tussocks_per_m2: float = 2.0  # Number per square metre and mean height [m] of bumps of about 0.15 m radius
    tussock_m: float = 0.07
    # Standard deviation of the logarithm of roughness and tussocks from place to place, over 5 to 25 m; real ground
    # is never equally rough everywhere
    unevenness: float = 1.2


_GRASS = Relief()
_GRASS_B = Relief(replace(_PARK, relief_shortest_m=6.0), 0.012, 1.6, 0.06, 1.1)
_DIRT = Relief(replace(_PARK, roughness_rms_m=0.025), 0.018, 0.4, 0.06, 0.8)
SITES: Mapping[str, tuple[Relief, str]] = {
    "grass_a": (_GRASS, "grass"),
    "grass_b": (_GRASS_B, "grass"),
    "dirt": (_DIRT, "dirt"),
}
SURVEYS: Mapping[str, SurveyQuality] = {
    "scanner": SurveyQuality(0.1, noise_m=0.004, smoothing_m=0.06),
    "robot": SurveyQuality(0.1, noise_m=0.02, smoothing_m=0.05),
    "drone": SurveyQuality(0.1, noise_m=0.03, correlation_m=0.2, smoothing_m=0.1),
    "lidar": SurveyQuality(0.5, noise_m=0.05, smoothing_m=0.15),
    "national": SurveyQuality(1.0, noise_m=0.1, smoothing_m=0.3, quantum_m=0.01),
}
"""Surveys as they are made: a scanner on a tripod, the robot's own lidar, photogrammetry from a drone, lidar from an
aircraft for one site, and the terrain model of a country."""
_SHARP = 0.5
"""Share of the random surveys that blur nothing beyond the mean over a cell."""
_NOISY, _NOISY_M = 0.5, (0.008, 0.16)
"""Share of the random surveys that are noisier than a scanner's, and their noise [m]."""
_CORRELATED, _ROUNDED = 0.25, 0.15
"""Share of these whose noise is alike over some decimetres, and of all whose heights are rounded."""
_ROLLING_SPREAD, _BUMP_SPREAD = 0.10, 0.05  # of the logarithms, between two meadows
_PLASTIC = 1.324717957244746  # the plastic ratio, x**3 = x + 1


def named_site(name: str, *, seed: int = 0, width_m: float = 60.0, height_m: float = 40.0) -> Site:
    """Return a named site; the same name and seed always give the same site.

    `width_m`, `height_m`: size of the site, east and north [m]. Raises NotFoundError for another name.
    """
    if name not in SITES:
        raise NotFoundError(f"there is no simulated site {name!r}; known are {', '.join(SITES)}", name=name)
    relief, kind = SITES[name]
    ground = _another_meadow(GROUNDS[kind], seed) if name == "grass_b" else GROUNDS[kind]
    rng = np.random.default_rng([seed, *name.encode()])
    frame = GridFrame(500000.0, 4980000.0, TRUE_RESOLUTION_M, _cells(height_m), _cells(width_m), "EPSG:32615")
    return make_site(name, relief, ground, frame, rng, SURVEYS["scanner"])


def random_site(
    rng: np.random.Generator,
    *,
    max_slope_deg: float = 30.0,
    size_m: float = 30.0,
    survey: SurveyQuality | None = None,
) -> Site:
    """Draw a site for pre-training: ground, relief, roughness and survey."""
    slope = max_slope_deg * float(rng.uniform(0.1, 1.0))
    rough = math.exp(0.6 * rng.standard_normal())
    tilt = slope * float(rng.uniform(0.0, 0.6))
    hills = TerrainRecipe(
        max_slope_deg=slope,
        tilt_deg=tilt,
        tilt_heading_deg=float(rng.uniform(0.0, 360.0)),
        relief_shortest_m=float(rng.uniform(4.0, 12.0)),
        roughness_rms_m=0.018 * rough * math.exp(0.5 * rng.standard_normal()),
        roughness_longest_m=float(rng.uniform(3.0, 6.0)),
        roughness_exponent=float(rng.uniform(3.5, 4.5)),
        furrow_depth_m=float(rng.uniform(0.02, 0.10)) if rng.random() < 0.1 else 0.0,
        furrow_heading_deg=float(rng.uniform(0.0, 180.0)),
        track_count=int(rng.integers(1, 5)) if rng.random() < 0.15 else 0,
    )
    relief = Relief(
        hills,
        rough_m=0.008 * rough * math.exp(0.4 * rng.standard_normal()),
        tussocks_per_m2=float(rng.uniform(0.0, 2.5)),
        tussock_m=float(rng.uniform(0.02, 0.08)),
        unevenness=float(rng.uniform(0.3, 1.2)),
    )
    ground = random_ground(rng)
    if survey is None:
        survey = _random_scan(rng)
    frame = GridFrame(0.0, size_m, TRUE_RESOLUTION_M, _cells(size_m), _cells(size_m))
    return make_site("random", relief, ground, frame, rng, survey)


def _random_scan(rng: np.random.Generator) -> SurveyQuality:
    resolution_m = float(rng.choice([0.05, 0.1, 0.1, 0.2, 0.25, 0.5, 1.0]))
    return SurveyQuality(
        resolution_m, noise_m=float(rng.uniform(0.001, 0.012)), smoothing_m=float(rng.uniform(0.02, 0.15))
    )


def random_survey(rng: np.random.Generator) -> SurveyQuality:
    """Draw a survey as somebody may have made it: half of them by scanner, the others with up to 160 mm of noise.

    Of a quarter of the noisy ones the noise is alike over up to 1 m; some heights are rounded.
    """
    quality = _random_scan(rng)
    if rng.random() < _SHARP:
        quality = replace(quality, smoothing_m=0.0)
    if rng.random() < _NOISY:
        quality = replace(quality, noise_m=math.exp(rng.uniform(*np.log(_NOISY_M))))
        if rng.random() < _CORRELATED:
            quality = replace(quality, correlation_m=float(rng.uniform(0.1, 1.0)))
    if rng.random() < _ROUNDED:
        quality = replace(quality, quantum_m=float(rng.choice([0.001, 0.01, 0.1])))
    return quality


def random_ground(rng: np.random.Generator) -> Ground:
    """Draw a ground around those of `GROUNDS`."""
    base = list(GROUNDS.values())[int(rng.integers(len(GROUNDS)))]
    return replace(
        base,
        name="random",
        mu=base.mu * math.exp(0.3 * rng.standard_normal()),
        load_exponent=float(rng.uniform(0.05, 0.4)),
        bump_loss=base.bump_loss * math.exp(0.3 * rng.standard_normal()),
        scrub=base.scrub * math.exp(0.3 * rng.standard_normal()),
        tpi_share=base.tpi_share * math.exp(0.4 * rng.standard_normal()),
    )


def make_site(
    name: str,
    relief: Relief,
    ground: Ground,
    frame: GridFrame,
    rng: np.random.Generator,
    survey: SurveyQuality,
) -> Site:
    """Build the terrain, the maps of rolling loss, and the survey."""
    seen = Heightmap(_relief(relief, frame, rng), frame, f"simulated {name}")
    surveyed = degrade(seen, survey, rng=rng)
    finer = fractal(frame, rng, exponent=2.0, rms_m=1.0, longest_m=0.35)
    terrain = replace(seen, heights=seen.heights + np.float32(ground.tussock_m) * finer)
    explained, factor = _soil(seen.heights, ground, frame, rng)
    return Site(name, terrain, surveyed, ground, factor, explained)


def _another_meadow(ground: Ground, seed: int) -> Ground:
    """The same kind of ground elsewhere: softer or firmer, which is invisible from above.

    Over seeds the two spreads are log-normal, and quasi-random (Roberts' R2 sequence, 2018), so that any handful of
    seeds in a row has softer and firmer meadows in balance.
    """
    softer, rougher = ndtri((0.5 + seed / np.array([_PLASTIC, _PLASTIC**2])) % 1.0)
    return replace(
        ground,
        mu=ground.mu * math.exp(_ROLLING_SPREAD * softer),
        bump_loss=ground.bump_loss * math.exp(_BUMP_SPREAD * rougher),
        patchiness=0.03,
    )


def _cells(metres: float) -> int:
    return round(metres / TRUE_RESOLUTION_M)


def _relief(relief: Relief, frame: GridFrame, rng: np.random.Generator) -> NDArray[np.float32]:
    hills = make_terrain(relief.hills, frame, rng).heights
    where = fractal(frame, rng, exponent=3.0, rms_m=relief.unevenness, longest_m=25.0, shortest_m=5.0)
    uneven = np.minimum(np.exp(where - 0.5 * relief.unevenness**2), 3.0)
    detail = fractal(frame, rng, exponent=2.5, rms_m=relief.rough_m, longest_m=1.2, shortest_m=0.15)
    humps = bumps(frame, rng, per_m2=relief.tussocks_per_m2, height_m=relief.tussock_m, radius_m=0.15)
    tallest = max(3.0 * relief.tussock_m, 1e-6)
    return np.asarray(hills + uneven * detail + tallest * np.tanh(uneven * humps / tallest), dtype=np.float32)


def _soil(
    heights: NDArray[np.float32], ground: Ground, frame: GridFrame, rng: np.random.Generator
) -> tuple[Heightmap, Heightmap]:
    """Maps of rolling loss: (by the topographic position index, also with the patches that follow from nothing)."""
    coarse = frame.respaced(_SOIL_M)
    x, y = coarse.centres()
    row, col = frame.rowcol(*np.meshgrid(x, y))
    ratio = _SOIL_M / frame.resolution_m
    at = map_coordinates(gaussian_filter(heights, ratio, mode="nearest"), [row, col], order=1, mode="nearest")
    depth = gaussian_filter(at, 1.5 / _SOIL_M, mode="nearest") - at
    explained = 1.0 + ground.tpi_share * np.clip(depth / 0.1, -3.0, 3.0)
    patches = gaussian_filter(rng.standard_normal(coarse.shape), 3.0 / _SOIL_M, mode="wrap")
    factor = explained * np.exp(ground.patchiness * patches / patches.std())
    return Heightmap(explained.astype(np.float32), coarse), Heightmap(factor.astype(np.float32), coarse)
