"""Seeded terrains: relief, tilt, furrows, bumps and wheel tracks, put together by a recipe."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.random import Generator

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_vector
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.landforms import HeightArray, bumps, fractal, furrows, hill, tilted_plane, tracks


@dataclass(frozen=True)
class TerrainRecipe:
    """What a terrain is made of. A part whose size is 0 is left out."""

    # Steepest slope of relief and tilt together, reached somewhere [deg]. Finer parts are added on top.
    max_slope_deg: float = 5.0
    tilt_deg: float = 0.0  # Slope of a plane, and the heading towards which it climbs [deg]
    tilt_heading_deg: float = 0.0
    relief_longest_m: float = 50.0  # Wavelengths of the relief [m]
    relief_shortest_m: float = 8.0
    # The 2-D spectral density of the relief falls as wavenumber^-exponent; 3.5 is natural ground
    relief_exponent: float = 3.5
    # The same for relief below the scale of a robot, with its root mean square height [m]
    roughness_rms_m: float = 0.008
    roughness_longest_m: float = 2.0
    roughness_exponent: float = 2.5
    furrow_depth_m: float = 0.0  # Parallel sine furrows that run along the heading
    furrow_spacing_m: float = 0.75
    furrow_heading_deg: float = 0.0
    bumps_per_m2: float = 0.0  # Number of tussocks and stones per square metre
    bump_height_m: float = 0.05  # Their mean height (exponentially distributed; negative means holes) and radius [m]
    bump_radius_m: float = 0.15
    track_count: int = 0  # Number of pairs of wheel ruts along random lines
    track_depth_m: float = 0.05  # Depth of a rut, distance between the two of a pair, and width of a rut [m]
    track_gauge_m: float = 1.5
    track_width_m: float = 0.3

    def __post_init__(self) -> None:
        for key, value in asdict(self).items():
            if not math.isfinite(value) or (value < 0 and key not in ("bump_height_m", *_HEADINGS)):
                raise InputError(f"terrain recipe: {key} = {value} must be a number, not negative", key=key)
        if self.max_slope_deg > 60.0:
            raise InputError(f"terrain recipe: max_slope_deg = {self.max_slope_deg:g} is over 60", limit=60.0)
        if self.tilt_deg > self.max_slope_deg:
            raise InputError(
                f"terrain recipe: tilt_deg = {self.tilt_deg:g} is over max_slope_deg = {self.max_slope_deg:g}"
            )
        for key in _LENGTHS:
            if getattr(self, key) <= 0.0:
                raise InputError(f"terrain recipe: {key} must be a positive number of metres", key=key)


_HEADINGS = ("tilt_heading_deg", "furrow_heading_deg")
_LENGTHS = (
    "relief_longest_m",
    "relief_shortest_m",
    "roughness_longest_m",
    "furrow_spacing_m",
    "bump_radius_m",
    "track_width_m",
)

PARK = TerrainRecipe(bumps_per_m2=0.3, bump_height_m=0.02)
"""A mown park like the paper's sites (60 x 40 m, slopes within 5 degrees)."""

HILLSIDE = TerrainRecipe(
    max_slope_deg=30.0,
    tilt_deg=14.0,
    relief_longest_m=60.0,
    relief_shortest_m=12.0,
    roughness_rms_m=0.02,
    bumps_per_m2=0.5,
    bump_height_m=0.05,
)
"""A steep rough hillside, up to 30 degrees."""


def make_terrain(recipe: TerrainRecipe, frame: GridFrame, rng: Generator) -> Heightmap:
    """Make the terrain of a recipe; its mean height is 0."""
    relief = fractal(
        frame,
        rng,
        exponent=recipe.relief_exponent,
        rms_m=1.0,
        longest_m=recipe.relief_longest_m,
        shortest_m=recipe.relief_shortest_m,
    )
    tilt_rad, tilt_heading = math.radians(recipe.tilt_deg), math.radians(recipe.tilt_heading_deg)
    limit = math.tan(math.radians(recipe.max_slope_deg))
    heights = relief * np.float32(_relief_scale(relief, frame, math.tan(tilt_rad), tilt_heading, limit))
    del relief
    if recipe.tilt_deg:
        heights += tilted_plane(frame, slope_rad=tilt_rad, heading_rad=tilt_heading)
    if recipe.roughness_rms_m:
        heights += fractal(
            frame,
            rng,
            exponent=recipe.roughness_exponent,
            rms_m=recipe.roughness_rms_m,
            longest_m=recipe.roughness_longest_m,
            shortest_m=0.0,
        )
    if recipe.furrow_depth_m:
        heights += furrows(
            frame,
            rng,
            depth_m=recipe.furrow_depth_m,
            spacing_m=recipe.furrow_spacing_m,
            heading_rad=math.radians(recipe.furrow_heading_deg),
        )
    if recipe.bumps_per_m2 and recipe.bump_height_m:
        heights += bumps(
            frame, rng, per_m2=recipe.bumps_per_m2, height_m=recipe.bump_height_m, radius_m=recipe.bump_radius_m
        )
    if recipe.track_count and recipe.track_depth_m:
        heights += tracks(
            frame,
            rng,
            count=recipe.track_count,
            depth_m=recipe.track_depth_m,
            gauge_m=recipe.track_gauge_m,
            width_m=recipe.track_width_m,
        )
    heights -= np.float32(heights.mean(dtype=np.float64))
    return Heightmap(heights, frame, source="synthesis")


SAMPLE_START = (22.0, 96.0)
SAMPLE_GOAL = (178.0, 104.0)
"""Two places of `sample_terrain` (x, y) [m] with the knoll between them."""


def sample_terrain(seed: int = 7) -> Heightmap:
    """Make the terrain of the demo: 200 x 200 m of rolling hills with a steep knoll in the middle.

    Between SAMPLE_START and SAMPLE_GOAL the shortest way climbs the knoll; the energy-optimal way goes round it.

    Result: 400 x 400 cells of 0.5 m, with a small pond of unknown height.
    """
    frame = GridFrame(west_m=0.0, north_m=200.0, resolution_m=0.5, rows=400, cols=400)
    rng = np.random.default_rng(seed)
    rolling = TerrainRecipe(
        max_slope_deg=8.0, relief_longest_m=90.0, relief_shortest_m=15.0, roughness_rms_m=0.01, bumps_per_m2=0.05
    )
    heights = make_terrain(rolling, frame, rng).heights + np.float32(120.0)
    for x, y, height_m, radius_m in _SAMPLE_HILLS:
        heights += hill(frame, x=x, y=y, height_m=height_m, radius_m=radius_m)
    xs, ys = frame.centres()
    pond = ((xs - 40.0) / 8.0)[None, :] ** 2 + ((ys - 84.0) / 6.0)[:, None] ** 2 < 1.0
    heights[pond] = np.nan
    return Heightmap(heights, frame, source=f"sample terrain, seed {seed}")


_SAMPLE_HILLS = (  # x, y, height, radius [m]
    (100.0, 100.0, 18.0, 29.0),
    (45.0, 165.0, 9.0, 28.0),
    (160.0, 175.0, 7.0, 25.0),
    (170.0, 25.0, 8.0, 26.0),
    (20.0, 20.0, 5.0, 22.0),
)


def _relief_scale(relief: HeightArray, frame: GridFrame, tilt: float, heading_rad: float, limit: float) -> float:
    """The factor s at which |tilt + s grad relief| first reaches `limit` (all as tan)."""
    dx, dy = heading_vector(heading_rad)
    down, east = np.gradient(relief, np.float32(frame.resolution_m))
    along = tilt * (dx * east - dy * down)
    square = np.maximum(np.square(east) + np.square(down), np.float32(1e-20))
    return float(np.min((np.sqrt(along**2 + square * (limit**2 - tilt**2)) - along) / square))
