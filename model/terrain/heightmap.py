"""The Heightmap value: heights on a north-up grid, with unknown cells kept unknown."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.denoising import (
    LEAST_NOISE_M,
    check_noise,
    denoised,
    hiding_noise_m,
)
from joulemap.model.terrain.layers import NO_LAYERS, Layers
from joulemap.model.terrain.layers.layer import HEIGHT
from joulemap.model.terrain.noise_estimate import Surveyed
from joulemap.model.terrain.rows import share_of

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Heightmap(Surveyed):
    """Heights of the ground on a north-up grid.

    Attributes
    ----------
    heights : ndarray of float32, (rows, cols)
        Heights [m], row 0 in the north, NaN where unknown; read-only.
    frame : GridFrame
        Where the grid lies.
    source : str
        Where the heights are from, in words.
    part : bool
        Whether this is a part of a larger map; only then may every height be unknown.
    notes : tuple of str
        What was done to the file's heights as it was read.
    given_noise_m : float or None
        Standard deviation of the noise of the survey [m], where it is known; else it is estimated.
    removed_noise_m : float
        Standard deviation of the noise that was taken out [m], of an independent one that hides as much of the finest
        details; 0 for a survey as it is.
    given_noise_length_m : float
        Length over which the given noise is alike [m], see `model.terrain.denoising.correlation_of`; 0 where it is
        independent from cell to cell.
    layers : Layers
        What is known of the ground beside its height: kinds of ground, obstacles, costs.

    Raises
    ------
    HeightmapError
        If the shape does not fit the frame, a height is infinite, or no height is known.
    """

    heights: NDArray[np.float32]
    frame: GridFrame
    source: str = field(default="memory")
    part: bool = False
    notes: tuple[str, ...] = ()
    given_noise_m: float | None = None
    removed_noise_m: float = 0.0
    given_noise_length_m: float = 0.0
    layers: Layers = NO_LAYERS

    def __post_init__(self) -> None:
        heights = np.ascontiguousarray(self.heights, dtype=np.float32)
        if heights.shape != self.frame.shape:
            raise HeightmapError(f"heights are {heights.shape}, but the frame is {self.frame.shape}")
        if min(heights.shape) < 2:
            raise HeightmapError(f"a heightmap needs at least 2 x 2 cells, got {heights.shape[0]} x {heights.shape[1]}")
        if np.isinf(heights).any():
            raise HeightmapError("heights must be finite or NaN (unknown), found an infinite one")
        if not self.part and np.isnan(heights).all():
            raise HeightmapError("every cell of the heightmap is unknown: there is no ground to plan on")
        check_noise(self.given_noise_m, self.given_noise_length_m)
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)

    def __repr__(self) -> str:
        rows, cols = self.frame.shape
        side = self.resolution_m
        low, high = self.height_range
        crs = self.frame.crs_in_words
        return (
            f"Heightmap {self.source}: {rows} x {cols} cells of {side:g} m ({cols * side:g} m east, {rows * side:g} m "
            f"north), heights {low:.2f} to {high:.2f} m, {100 * self.known_share:.4g} % known, {crs}"
        )

    @property
    def resolution_m(self) -> float:
        """Side of a cell [m]."""
        return self.frame.resolution_m

    @cached_property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest known height [m]; NaN where none is known."""
        known = self.heights[~np.isnan(self.heights)]
        return (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)

    @cached_property
    def known_share(self) -> float:
        """Share of cells whose height is known, 0..1."""
        return float(1.0 - np.isnan(self.heights).mean())

    @cached_property
    def data_hash(self) -> str:
        """SHA-256 (16 hex digits) of heights and frame: the identity of the heightmap in provenance."""
        digest = hashlib.sha256(self.heights.data)
        digest.update(self.frame.identity.encode())
        return digest.hexdigest()[:16]

    @cached_property
    def without_noise(self) -> Heightmap:
        """The expected ground, given this survey: what prices and limits are made of; itself where it has no noise."""
        if self.noise_m < LEAST_NOISE_M:
            return self
        length = self.noise_length_m / self.resolution_m
        removed = hiding_noise_m(self.noise_m, length)
        heights = self.layers.over(denoised(self.heights, self.noise_m, length), self.frame)
        return replace(self, heights=heights, given_noise_m=0.0, given_noise_length_m=0.0, removed_noise_m=removed)

    def with_layers(self, layers: Layers) -> Heightmap:
        """Return the map with layers in place of those that it has, but for heights: those stay, under new ones.

        Parameters
        ----------
        layers : Layers
            What is known of the ground.

        Returns
        -------
        Heightmap
            With the heights of layers that have any.
        """
        every = Layers((*self.layers.of(HEIGHT), *layers.each))
        return replace(self, heights=layers.over(self.heights, self.frame), layers=every)

    @property
    def bare(self) -> Heightmap:
        """The heights, with those of layers, and nothing else of layers."""
        return replace(self, layers=NO_LAYERS) if self.layers else self

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
        """Return the heights of cells [row0, row1) x [col0, col1).

        Parameters
        ----------
        row0, row1, col0, col1 : int
            The window, at least 2 x 2 cells.

        Returns
        -------
        Heightmap
            That part of the map.
        """
        heights = self.heights[row0:row1, col0:col1]
        place = self.frame.window(row0, row1, col0, col1)
        removed = self.removed_noise_m
        return Heightmap(heights, place, self.source, part=True, removed_noise_m=removed, layers=self.layers)

    def sample(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Return bilinear heights at world points.

        Parameters
        ----------
        x, y : array_like
            World points [m]; their shapes are broadcast.

        Returns
        -------
        ndarray of float64
            Heights [m]. NaN outside the bounds and wherever a height with non-zero weight is unknown.

        Notes
        -----
        A cell is an area. In the outer half cell the nearest square of four centres is continued linearly.
        """
        row, col = self.frame.rowcol(x, y)
        row, col = np.broadcast_arrays(row, col)
        flat = sample_bilinear(self.heights, np.ascontiguousarray(row).ravel(), np.ascontiguousarray(col).ravel())
        return flat.reshape(row.shape)


@njit(cache=True)
def bilinear(values: NDArray[np.float32], row: float, col: float) -> float:
    """Return the bilinear value at one place.

    Parameters
    ----------
    values : ndarray of float32, (rows, cols)
        Values at the cell centres, NaN where unknown.
    row, col : float
        Fractional cell.

    Returns
    -------
    float
        The value; continued linearly in the outer half cell, NaN beyond it.
    """
    rows, cols = values.shape
    edge = 0.5 + 1e-6
    if not (-edge <= row <= rows - 1 + edge and -edge <= col <= cols - 1 + edge):
        return math.nan
    i = min(max(math.floor(row), 0), rows - 2)
    j = min(max(math.floor(col), 0), cols - 2)
    fr, fc = share_of(row, i), share_of(col, j)
    total = 0.0
    for di in range(2):
        wr = fr if di == 1 else 1.0 - fr
        if wr == 0.0:
            continue
        for dj in range(2):
            wc = fc if dj == 1 else 1.0 - fc
            if wc == 0.0:
                continue
            total += wr * wc * values[i + di, j + dj]
    return total


@njit(cache=True, nogil=True)
def sample_bilinear(values: NDArray[np.float32], row: FloatArray, col: FloatArray) -> FloatArray:
    """Return `bilinear` values at many places.

    Parameters
    ----------
    values : ndarray of float32, (rows, cols)
        Values at the cell centres, NaN where unknown.
    row, col : ndarray of float64, (n,)
        Fractional cells.

    Returns
    -------
    ndarray of float64, (n,)
        The values.
    """
    out = np.empty(row.size)
    for k in range(row.size):
        out[k] = bilinear(values, row[k], col[k])
    return out
