"""A random site: a smooth surface that is known everywhere, and its heightmap."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.loop.generators.config import SiteConfig

FloatArray = NDArray[np.float64]

CRS = "EPSG:32615"
_WEST_M, _SOUTH_M, _HEIGHT_M = 501_000.0, 4_981_500.0, 310.0  # somewhere in UTM zone 15 north


@dataclass(frozen=True, eq=False)
class Site:
    """A surface of plane cosine waves.

    Attributes
    ----------
    config : SiteConfig
        What it was drawn from.
    wave_x, wave_y : ndarray of float, (k,)
        Wave vectors [rad/m].
    amplitude_m, phase : ndarray of float, (k,)
        Of the waves.
    """

    config: SiteConfig
    wave_x: FloatArray
    wave_y: FloatArray
    amplitude_m: FloatArray
    phase: FloatArray

    @classmethod
    def drawn(cls, config: SiteConfig, rng: np.random.Generator) -> Site:
        """Draw a site whose slope has the root mean square that the settings ask for."""
        shortest, longest = config.wave_m
        length = shortest * (longest / shortest) ** rng.random(config.waves)
        direction, phase = rng.uniform(0.0, 2 * np.pi, (2, config.waves))
        number = 2 * np.pi / length
        amplitude = rng.normal(size=config.waves) * length**0.8  # longer waves are higher
        slope = np.sqrt(0.5 * np.sum((amplitude * number) ** 2))
        amplitude *= config.grade_rms / slope
        return cls(config, number * np.sin(direction), number * np.cos(direction), amplitude, phase)

    def height_m(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the ground [m] at world points, in the shape of `x`."""
        phase = np.multiply.outer(np.asarray(x) - _WEST_M, self.wave_x)
        phase += np.multiply.outer(np.asarray(y) - _SOUTH_M, self.wave_y)  # (..., k)
        return np.asarray(_HEIGHT_M + np.cos(phase + self.phase) @ self.amplitude_m)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north [m]."""
        return _WEST_M, _SOUTH_M, _WEST_M + self.config.width_m, _SOUTH_M + self.config.height_m

    @cached_property
    def heightmap(self) -> Heightmap:
        """The survey of the site: heights of the cell centres."""
        west, _, _, north = self.bounds
        cell = self.config.cell_m
        rows, cols = round(self.config.height_m / cell), round(self.config.width_m / cell)
        x = west + cell * (np.arange(cols) + 0.5)
        y = north - cell * (np.arange(rows) + 0.5)
        heights = np.zeros((rows, cols))  # the cosine of a sum is separable
        for kx, ky, a, p in zip(self.wave_x, self.wave_y, self.amplitude_m, self.phase, strict=True):
            east, rest = kx * (x - _WEST_M), ky * (y - _SOUTH_M) + p
            heights += a * (np.outer(np.cos(rest), np.cos(east)) - np.outer(np.sin(rest), np.sin(east)))
        frame = GridFrame(west, north, cell, rows, cols, CRS)
        return Heightmap((_HEIGHT_M + heights).astype(np.float32), frame, source="random site")

    def write(self, path: Path) -> None:
        """Write the heightmap as a GeoTIFF."""
        write_geotiff(path, self.heightmap)
