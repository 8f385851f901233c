"""Landforms to put terrains together from: fractal ground, planes, hills, furrows, bumps and wheel tracks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import fft

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_vector

FloatArray = NDArray[np.float64]
HeightArray = NDArray[np.float32]


def fractal(
    frame: GridFrame, rng: Generator, *, exponent: float, rms_m: float, longest_m: float, shortest_m: float = 0.0
) -> HeightArray:
    """Make an isotropic Gaussian random surface with a power-law spectrum between two wavelengths.

    Result (rows, cols): heights [m].

    Filtered white noise, by FFT on a grid that is larger by `longest_m`, so that opposite edges do not match.
    """
    margin = math.ceil(min(longest_m, 0.5 * max(frame.shape) * frame.resolution_m) / frame.resolution_m)
    rows, cols = (fft.next_fast_len(n + margin, real=True) for n in frame.shape)
    spectrum = rng.standard_normal((rows, cols), dtype=np.float32)
    spectrum = fft.rfft2(spectrum, overwrite_x=True)
    ky = fft.fftfreq(rows, frame.resolution_m)[:, None]
    kx = fft.rfftfreq(cols, frame.resolution_m)[None, :]
    k = np.hypot(ky, kx).astype(np.float32)  # cycles per metre
    k[0, 0] = np.inf
    gain = k ** np.float32(-0.5 * exponent)
    longest = max(longest_m, 2.0 * frame.resolution_m)
    gain[k < 1.0 / longest] = 0.0
    if shortest_m > 0.0:
        gain *= np.exp(-((k * np.float32(shortest_m)) ** 4))
        gain[0, 0] = 0.0
    spectrum *= gain
    surface = fft.irfft2(spectrum, s=(rows, cols), overwrite_x=True)
    rms = float(np.sqrt(np.mean(np.square(surface), dtype=np.float64)))
    if rms == 0.0:
        raise InputError(
            f"no wave between {shortest_m:g} and {longest_m:g} m fits on a map of "
            f"{frame.cols * frame.resolution_m:g} x {frame.rows * frame.resolution_m:g} m"
        )
    return np.ascontiguousarray(surface[: frame.rows, : frame.cols]) * np.float32(rms_m / rms)


def tilted_plane(frame: GridFrame, *, slope_rad: float, heading_rad: float) -> HeightArray:
    """Make a tilted plane, zero at the south-west corner. Result (rows, cols): heights [m]."""
    dx, dy = heading_vector(heading_rad)
    x, y = frame.centres()
    west, south, _, _ = frame.bounds
    along = (x - west)[None, :] * dx + (y - south)[:, None] * dy
    return (math.tan(slope_rad) * along).astype(np.float32)


def hill(frame: GridFrame, *, x: float, y: float, height_m: float, radius_m: float) -> HeightArray:
    """Make a Gaussian hill. `x`, `y`: world place of the top [m]. Result (rows, cols): heights [m]."""
    xs, ys = frame.centres()
    across = np.exp(-0.5 * ((xs - x) / radius_m) ** 2)
    return (height_m * np.exp(-0.5 * ((ys - y) / radius_m) ** 2)[:, None] * across[None, :]).astype(np.float32)


def furrows(frame: GridFrame, rng: Generator, *, depth_m: float, spacing_m: float, heading_rad: float) -> HeightArray:
    """Make parallel sine furrows with a random phase. Result (rows, cols): heights [m]."""
    dx, dy = heading_vector(heading_rad)
    x, y = frame.centres()
    west, south, _, _ = frame.bounds
    across = (x - west)[None, :] * dy - (y - south)[:, None] * dx
    phase = rng.uniform(0.0, math.tau)
    return (0.5 * depth_m * np.sin(across * (math.tau / spacing_m) + phase)).astype(np.float32)


def bumps(frame: GridFrame, rng: Generator, *, per_m2: float, height_m: float, radius_m: float) -> HeightArray:
    """Make Gaussian bumps at random places. Result (rows, cols): heights [m]."""
    margin = 4.0 * radius_m
    west, south, east, north = frame.bounds
    count = rng.poisson(per_m2 * (east - west + 2 * margin) * (north - south + 2 * margin))
    row, col = frame.rowcol(
        rng.uniform(west - margin, east + margin, count), rng.uniform(south - margin, north + margin, count)
    )
    height = height_m * rng.exponential(1.0, count)
    radius = radius_m * rng.uniform(0.5, 1.5, count) / frame.resolution_m
    surface = np.zeros(frame.shape, dtype=np.float32)
    _stamp_bumps(surface, row, col, height, radius)
    return surface


@njit(cache=True)
def _stamp_bumps(
    surface: HeightArray, row: FloatArray, col: FloatArray, height: FloatArray, radius: FloatArray
) -> None:
    rows, cols = surface.shape
    for k in range(row.size):
        reach = 4.0 * radius[k]
        top, bottom = max(0, math.ceil(row[k] - reach)), min(rows - 1, math.floor(row[k] + reach))
        left, right = max(0, math.ceil(col[k] - reach)), min(cols - 1, math.floor(col[k] + reach))
        for i in range(top, bottom + 1):
            for j in range(left, right + 1):
                square = ((i - row[k]) ** 2 + (j - col[k]) ** 2) / (radius[k] * radius[k])
                surface[i, j] += height[k] * math.exp(-0.5 * square)


def tracks(
    frame: GridFrame, rng: Generator, *, count: int, depth_m: float, gauge_m: float, width_m: float
) -> HeightArray:
    """Make pairs of wheel ruts along random straight lines; where they cross, the deeper one counts.

    Result (rows, cols): heights [m], none above 0.
    """
    x, y = frame.centres()
    west, south, east, north = frame.bounds
    surface = np.zeros(frame.shape, dtype=np.float32)
    for _ in range(count):
        dx, dy = heading_vector(rng.uniform(0.0, math.pi))
        through_x, through_y = rng.uniform(west, east), rng.uniform(south, north)
        across = (x - through_x)[None, :] * dy - (y - through_y)[:, None] * dx
        from_rut = (np.abs(across) - 0.5 * gauge_m) / (0.5 * width_m)
        np.minimum(surface, (-depth_m * np.exp(-(from_rut**4))).astype(np.float32), out=surface)
    return surface
