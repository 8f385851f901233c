"""Ground by windows: what work that goes tile by tile needs of a heightmap, whole in memory or in a file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.raster_files import GeoTiffHeader, geotiff_window

_STRIP_CELLS = 16_000_000  # of a file that are held at a time while it is read through once
_SAMPLE_CELLS = 16_000_000  # a larger map is judged by windows spread over it
_BLOCKS = 8  # of them along each side


class Ground(Protocol):
    """A heightmap of any size. `Heightmap` is one; so is a file that is never held whole."""

    @property
    def frame(self) -> GridFrame: ...

    @property
    def source(self) -> str:
        """Where it is from, in words."""

    @property
    def data_hash(self) -> str:
        """As `Heightmap.data_hash`."""

    @property
    def known_share(self) -> float:
        """As `Heightmap.known_share`."""

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
        """The heights of cells [row0, row1) x [col0, col1), at least 2 x 2 of them."""


@dataclass(frozen=True, eq=False)
class HeightmapFile:
    """A GeoTIFF read by windows; the same heights, identity and refusals as reading it whole.

    A tiled file is read fastest. Raises HeightmapError where a window cannot be read.
    """

    path: Path
    header: GeoTiffHeader
    scaling: Scaling
    frame: GridFrame
    source: str

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
        """The heights of cells [row0, row1) x [col0, col1), at least 2 x 2 of them."""
        heights = geotiff_window(self.path, self.header, self.scaling, slice(row0, row1), slice(col0, col1))
        return Heightmap(heights, self.frame.window(row0, row1, col0, col1), self.source, part=True)

    @property
    def data_hash(self) -> str:
        """As `Heightmap.data_hash`: SHA-256 (16 hex digits) of heights and frame."""
        return self._read_through[0]

    @property
    def known_share(self) -> float:
        """Share of cells whose height is known, 0..1. Raises HeightmapError where that is none."""
        return self._read_through[1]

    @cached_property
    def _read_through(self) -> tuple[str, float]:
        digest, known = hashlib.sha256(), 0
        for heights in self._strips():
            digest.update(heights.tobytes())
            known += int(np.count_nonzero(~np.isnan(heights)))
        digest.update(repr(self.frame).encode())
        if not known:
            raise HeightmapError("every cell of the heightmap is unknown: there is no ground to plan on")
        return digest.hexdigest()[:16], known / (self.frame.rows * self.frame.cols)

    def _strips(self) -> Iterator[np.ndarray]:
        step = max(1, _STRIP_CELLS // self.frame.cols)
        for row in range(0, self.frame.rows, step):
            rows = slice(row, min(row + step, self.frame.rows))
            yield geotiff_window(self.path, self.header, self.scaling, rows, slice(0, self.frame.cols))


def overview(ground: Ground) -> Heightmap:
    """The ground, or of a large one windows spread over it with unknown cells between: enough to judge its slopes by.

    A map of up to 16 million cells is itself.
    """
    frame = ground.frame
    if frame.rows * frame.cols <= _SAMPLE_CELLS:
        return ground.window(0, frame.rows, 0, frame.cols)
    gutter = max(4, math.ceil(4.0 / frame.resolution_m))  # wider than any slope is judged over
    side = math.isqrt(_SAMPLE_CELLS) // _BLOCKS

    def starts(length: int) -> list[tuple[int, int]]:
        count = min(_BLOCKS, max(1, length // side))
        wide = min(side, length)
        return [(int(at), int(at) + wide) for at in np.linspace(0, length - wide, count)]

    rows, cols = starts(frame.rows), starts(frame.cols)
    high, wide = (max(b - a for a, b in spans) + gutter for spans in (rows, cols))
    heights = np.full((high * len(rows), wide * len(cols)), np.nan, dtype=np.float32)
    for i, (row0, row1) in enumerate(rows):
        for j, (col0, col1) in enumerate(cols):
            part = ground.window(row0, row1, col0, col1).heights
            heights[i * high : i * high + row1 - row0, j * wide : j * wide + col1 - col0] = part
    spread = frame.window(0, heights.shape[0], 0, heights.shape[1])
    return Heightmap(heights, spread, ground.source, part=True)
