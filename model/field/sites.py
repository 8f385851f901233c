"""Named and random sites: the true terrain, what a survey gives of it, and the ground it is made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from model.errors import InputError, NotFoundError
from model.field.robot_dynamics import Ground
from model.frames import GridFrame
from model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

TRUE_RESOLUTION_M = 0.05
"""Cell of the true terrain [m]."""

_SOIL_M = 0.25  # cell of the maps of rolling loss
_MARGIN_M = 1.6  # drives keep this far from the edge, so that no wheel leaves the terrain

GROUNDS: Mapping[str, Ground] = {
    "grass": Ground(),
    "grass_b": Ground(name="grass", mu=0.072, bump_loss=0.95, patchiness=0.03),
    "dirt": Ground(
        name="dirt", mu=0.045, load_exponent=0.12, bump_loss=1.0, scrub=0.16, hollow_share=0.20, tussock_m=0.003
    ),
}


@dataclass(frozen=True)
class Site:
    """A place to drive.

    terrain : the truth, 5 cm. survey : the heightmap that is given to a model. mu_factor : what multiplies the ground's
    rolling loss from place to place; mu_factor_explained : its part that follows from the terrain (hollows).
    """

    name: str
    terrain: Heightmap
    survey: Heightmap
    ground: Ground
    mu_factor: Heightmap
    mu_factor_explained: Heightmap

    @property
    def drivable(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) [m] in which waypoints may lie."""
        west, south, east, north = self.terrain.frame.bounds
        return west + _MARGIN_M, south + _MARGIN_M, east - _MARGIN_M, north - _MARGIN_M


@dataclass(frozen=True)
class Relief:
    """Shape of a terrain.

    hills_m : shortest wavelength of the hills [m], scaled so that their slopes stay within max_slope_deg. swell_m,
    rough_m : rms height [m] of the relief of 1.2 to 5 m and of 0.25 to 1.2 m. tussocks_per_m2, tussock_m : number and
    mean height of humps 0.2 to 0.7 m wide. unevenness : spread (log) of roughness and tussocks from place to place.
    """

    max_slope_deg: float = 4.0
    hills_m: float = 8.0
    swell_m: float = 0.015
    rough_m: float = 0.010
    tussocks_per_m2: float = 2.0
    tussock_m: float = 0.07
    unevenness: float = 1.2


_GRASS = Relief()
_GRASS_B = Relief(hills_m=6.0, tussocks_per_m2=1.6, tussock_m=0.06, rough_m=0.012, unevenness=1.1)
_DIRT = Relief(swell_m=0.025, rough_m=0.018, tussocks_per_m2=0.4, tussock_m=0.06, unevenness=0.8)
_NAMED: Mapping[str, tuple[Relief, str, float]] = {
    "grass_a": (_GRASS, "grass", 0.1),
    "grass_b": (_GRASS_B, "grass_b", 0.1),
    "dirt": (_DIRT, "dirt", 0.1),
}


def named_site(name: str, *, seed: int = 0, width_m: float = 60.0, height_m: float = 40.0) -> Site:
    """grass_a, grass_b or dirt. Each (name, seed) is always the same site. Raises NotFoundError for another name."""
    if name not in _NAMED:
        raise NotFoundError(f"no simulated site {name!r}; known are {', '.join(_NAMED)}", name=name)
    relief, ground, survey_m = _NAMED[name]
    rng = np.random.default_rng([seed, *name.encode()])
    frame = GridFrame(500000.0, 4980000.0, TRUE_RESOLUTION_M, _cells(height_m), _cells(width_m), "EPSG:32615")
    return make_site(name, relief, GROUNDS[ground], frame, rng, survey_m=survey_m)


def random_site(
    rng: np.random.Generator,
    *,
    max_slope_deg: float = 30.0,
    size_m: float = 30.0,
    survey_m: float | None = None,
) -> Site:
    """A site for pre-training: ground, relief, roughness and survey (0.05 to 1 m) are drawn."""
    slope = max_slope_deg * float(rng.uniform(0.1, 1.0))
    rough = math.exp(0.6 * rng.standard_normal())
    relief = Relief(
        max_slope_deg=slope,
        hills_m=float(rng.uniform(4.0, 12.0)),
        swell_m=0.018 * rough * math.exp(0.5 * rng.standard_normal()),
        rough_m=0.008 * rough * math.exp(0.4 * rng.standard_normal()),
        tussocks_per_m2=float(rng.uniform(0.0, 2.5)),
        tussock_m=float(rng.uniform(0.02, 0.08)),
        unevenness=float(rng.uniform(0.3, 1.2)),
    )
    ground = random_ground(rng)
    if survey_m is None:
        survey_m = float(rng.choice([0.05, 0.1, 0.1, 0.2, 0.25, 0.5, 1.0]))
    frame = GridFrame(0.0, size_m, TRUE_RESOLUTION_M, _cells(size_m), _cells(size_m))
    return make_site("random", relief, ground, frame, rng, survey_m=survey_m)


def random_ground(rng: np.random.Generator) -> Ground:
    """A ground drawn around those of GROUNDS."""
    base = list(GROUNDS.values())[int(rng.integers(len(GROUNDS)))]
    return replace(
        base,
        name="random",
        mu=base.mu * math.exp(0.3 * rng.standard_normal()),
        load_exponent=float(rng.uniform(0.05, 0.4)),
        bump_loss=base.bump_loss * math.exp(0.3 * rng.standard_normal()),
        scrub=base.scrub * math.exp(0.3 * rng.standard_normal()),
        hollow_share=base.hollow_share * math.exp(0.4 * rng.standard_normal()),
    )


def make_site(
    name: str, relief: Relief, ground: Ground, frame: GridFrame, rng: np.random.Generator, *, survey_m: float
) -> Site:
    """Build the terrain, its survey (cells of `survey_m`) and the maps of rolling loss."""
    if survey_m < frame.resolution_m:
        raise InputError(
            f"a survey of {survey_m} m is finer than the truth ({frame.resolution_m} m)", survey_m=survey_m
        )
    heights = _relief(relief, frame, rng)
    survey = _survey(heights, frame, survey_m, rng)
    fine = heights + ground.tussock_m * _band(frame.shape, frame.resolution_m, 0.1, 0.35, rng)
    terrain = Heightmap(fine.astype(np.float32), frame, f"simulated {name}")
    explained, factor = _soil(heights, ground, frame, rng)
    return Site(name, terrain, survey, ground, factor, explained)


def _cells(metres: float) -> int:
    return round(metres / TRUE_RESOLUTION_M)


def _band(
    shape: tuple[int, int], resolution_m: float, shortest_m: float, longest_m: float, rng: np.random.Generator
) -> FloatArray:
    """Gaussian relief of unit rms with wavelengths between the two, spectrum falling as amplitude ~ wavelength."""
    noise = np.fft.rfft2(rng.standard_normal(shape))
    fy = np.fft.fftfreq(shape[0], resolution_m)[:, None]
    fx = np.fft.rfftfreq(shape[1], resolution_m)[None, :]
    f = np.hypot(fy, fx)
    inside = (f > 1.0 / longest_m) & (f < 1.0 / shortest_m)
    if not inside.any():
        return np.zeros(shape)
    gain = np.where(inside, 1.0 / np.maximum(f, 1e-9) ** 2, 0.0)
    out = np.fft.irfft2(noise * gain, s=shape)
    return np.asarray(out / out.std())


def _relief(relief: Relief, frame: GridFrame, rng: np.random.Generator) -> FloatArray:
    shape, res = frame.shape, frame.resolution_m
    hills = _band(shape, res, relief.hills_m, 60.0, rng)
    steepest = float(np.quantile(np.hypot(*np.gradient(hills, res)), 0.999))
    hills *= math.tan(math.radians(relief.max_slope_deg)) / max(steepest, 1e-12)
    uneven = np.exp(relief.unevenness * _band(shape, res, 5.0, 25.0, rng) - 0.5 * relief.unevenness**2)
    swell = relief.swell_m * _band(shape, res, 1.2, 5.0, rng)
    rough = relief.rough_m * _band(shape, res, 0.25, 1.2, rng)
    humps = np.zeros(shape)
    for radius_m in (0.10, 0.16, 0.25):
        here = rng.random(shape) < np.minimum(relief.tussocks_per_m2 / 3.0 * uneven * res * res, 1.0)
        peak = np.where(here, relief.tussock_m * rng.gamma(3.0, 1.0 / 3.0, shape), 0.0)
        sigma = radius_m / res
        humps += gaussian_filter(peak, sigma, mode="constant") * (2.0 * math.pi * sigma * sigma)
    tallest = 3.0 * max(relief.tussock_m, 1e-9)
    return np.asarray(300.0 + hills + swell + rough * np.minimum(uneven, 3.0) + tallest * np.tanh(humps / tallest))


def _survey(heights: FloatArray, frame: GridFrame, survey_m: float, rng: np.random.Generator) -> Heightmap:
    """What a survey gives: smoothed over its own cell (at least 8 cm), resampled, with a centimetre of smooth noise."""
    sigma = max(0.5 * survey_m, 0.08) / frame.resolution_m
    smooth = gaussian_filter(heights, sigma, mode="nearest")
    coarse = frame.respaced(survey_m)
    x, y = coarse.centres()
    row, col = frame.rowcol(*np.meshgrid(x, y))
    seen = map_coordinates(smooth, [row, col], order=1, mode="nearest")
    error = gaussian_filter(rng.standard_normal(coarse.shape), 1.0)
    seen = seen + 0.006 * error / error.std()
    return Heightmap(seen.astype(np.float32), coarse, "simulated survey")


def _soil(
    heights: FloatArray, ground: Ground, frame: GridFrame, rng: np.random.Generator
) -> tuple[Heightmap, Heightmap]:
    """Maps of rolling loss: (explained by hollows, with the patches that nothing explains)."""
    coarse = frame.respaced(_SOIL_M)
    x, y = coarse.centres()
    row, col = frame.rowcol(*np.meshgrid(x, y))
    ratio = _SOIL_M / frame.resolution_m
    at = map_coordinates(gaussian_filter(heights, ratio, mode="nearest"), [row, col], order=1, mode="nearest")
    depth = gaussian_filter(at, 1.5 / _SOIL_M, mode="nearest") - at
    explained = 1.0 + ground.hollow_share * np.clip(depth / 0.1, -3.0, 3.0)
    patches = gaussian_filter(rng.standard_normal(coarse.shape), 3.0 / _SOIL_M, mode="wrap")
    factor = explained * np.exp(ground.patchiness * patches / patches.std())
    return Heightmap(explained.astype(np.float32), coarse), Heightmap(factor.astype(np.float32), coarse)
