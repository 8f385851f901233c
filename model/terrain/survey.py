"""What a survey measures of a fine terrain: a blurred, coarser, noisy heightmap."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np
from numpy.random import Generator
from scipy import ndimage, sparse

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.heightmap import Heightmap


@dataclass(frozen=True, slots=True)
class SurveyQuality:
    """What a survey makes of the ground; all lengths in metres."""

    resolution_m: float  # Side of a cell
    noise_m: float = 0.0  # Standard deviation of the noise of a height
    correlation_m: float = 0.0  # Length over which the noise is alike (Gaussian); 0 for independent noise
    smoothing_m: float = 0.0  # Standard deviation of the Gaussian that blurs the heights first
    quantum_m: float = 0.0  # What heights are rounded to; 0 for no rounding

    def __post_init__(self) -> None:
        if not all(math.isfinite(length) and length >= 0 for length in astuple(self)):
            raise HeightmapError(f"lengths of a survey must be metres, not negative, got {self}")


def degrade(heightmap: Heightmap, quality: SurveyQuality, *, rng: Generator) -> Heightmap:
    """Make a survey of a terrain, on coarser cells from the same north-west corner.

    Result: mean heights over the area of each new cell; unknown where less than half of that area is known.
    """
    frame = heightmap.frame
    resolution_m = quality.resolution_m
    if not resolution_m >= frame.resolution_m * (1.0 - 1e-9):
        raise HeightmapError(
            f"a survey at {resolution_m:g} m cannot be made of a coarser terrain, at {frame.resolution_m:g} m",
            resolution_m=str(resolution_m),
            limit=frame.resolution_m,
        )
    coarse = frame.respaced(resolution_m)
    known = ~np.isnan(heightmap.heights)
    base = float(np.nanmean(heightmap.heights, dtype=np.float64))
    heights = np.where(known, heightmap.heights - np.float32(base), np.float32(0.0))
    if quality.smoothing_m > 0.0:
        sigma = quality.smoothing_m / frame.resolution_m
        weight = ndimage.gaussian_filter(known.astype(np.float32), sigma, mode="nearest")
        blurred = ndimage.gaussian_filter(heights, sigma, mode="nearest")
        heights = np.where(known, blurred / np.maximum(weight, np.float32(1e-6)), np.float32(0.0))
    ratio = resolution_m / frame.resolution_m
    by_row, by_col = _area_weights(frame.rows, coarse.rows, ratio), _area_weights(frame.cols, coarse.cols, ratio)
    share = by_row @ (by_col @ known.astype(np.float64).T).T
    total = by_row @ (by_col @ heights.astype(np.float64).T).T
    mean = np.where(share >= 0.5, total / np.maximum(share, 1e-12), np.nan) + base
    if quality.noise_m > 0.0:
        noise = rng.standard_normal(mean.shape)
        if quality.correlation_m > 0.0:
            noise = ndimage.gaussian_filter(noise, quality.correlation_m / resolution_m / math.sqrt(2.0), mode="wrap")
            noise /= noise.std()
        mean += quality.noise_m * noise
    if quality.quantum_m > 0.0:
        mean = quality.quantum_m * np.round(mean / quality.quantum_m)
    return Heightmap(mean.astype(np.float32), coarse, source=f"survey of {heightmap.source}")


def _area_weights(fine: int, coarse: int, ratio: float) -> sparse.csr_array:
    """(coarse, fine): share of a coarse cell's length that a fine cell covers; `ratio` fine cells to a coarse one."""
    span = math.ceil(ratio) + 1
    starts = np.arange(coarse) * ratio
    first = np.floor(starts + 1e-9).astype(np.int64)
    columns = first[:, None] + np.arange(span)  # (coarse, span)
    overlap = np.minimum(columns + 1, starts[:, None] + ratio) - np.maximum(columns, starts[:, None])
    overlap = np.where(columns < fine, np.clip(overlap, 0.0, None), 0.0)
    rows = np.repeat(np.arange(coarse), span)
    weights = (overlap / overlap.sum(axis=1, keepdims=True)).ravel()
    return sparse.csr_array((weights, (rows, np.minimum(columns, fine - 1).ravel())), shape=(coarse, fine))
