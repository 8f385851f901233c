"""Heights by windows: what work that proceeds tile by tile needs of a heightmap, whole in memory or in a file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.denoising import (
    LEAST_NOISE_M,
    check_noise,
    denoised,
    hiding_noise_m,
    margin_cells,
)
from joulemap.model.terrain.formats.contract import WindowReader
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers import NO_LAYERS, Layers
from joulemap.model.terrain.noise_estimate import Surveyed, SurveyNoise

_KEPT_CELLS = 32_000_000  # a file of up to so many is read once and kept, as windows would read most of it many times
_STRIP_CELLS = 16_000_000  # of a larger one that are held at a time while it is read through once
_SAMPLE_CELLS = 4_000_000  # a larger map is judged by windows spread over it
_BLOCKS = 8  # of them along each side


class Ground(Protocol):
    """A heightmap of any size: a `Heightmap`, or a file that is never held in memory as a whole."""

    @property
    def frame(self) -> GridFrame:
        """Where the grid lies."""

    @property
    def source(self) -> str:
        """Where it is from, in words."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the file's heights as it was read."""

    @property
    def data_hash(self) -> str:
        """As `Heightmap.data_hash`."""

    @property
    def known_share(self) -> float:
        """Share of cells whose height is known, 0..1."""

    @property
    def noise(self) -> SurveyNoise:
        """The noise of the survey, given or estimated."""

    @property
    def given_noise_m(self) -> float | None:
        """Its standard deviation [m] where the user gave it."""

    @property
    def layers(self) -> Layers:
        """What is known of the ground beside its height."""

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
        """Return the heights of cells [row0, row1) x [col0, col1)."""


@dataclass(frozen=True, eq=False)
class HeightmapFile(Surveyed):
    """A file read by windows, with the same heights, identity and refusals as reading it whole.

    A small file is kept in memory after it was read for the first window.
    """

    reader: WindowReader  # The open format
    scaling: Scaling  # How stored values become metres
    frame: GridFrame  # Where the grid lies
    source: str  # The file's name
    notes: tuple[str, ...] = ()  # As `Heightmap.notes`
    given_noise_m: float | None = None  # As those of `Heightmap`
    given_noise_length_m: float = 0.0
    layers: Layers = NO_LAYERS  # As `Heightmap.layers`

    def __post_init__(self) -> None:
        check_noise(self.given_noise_m, self.given_noise_length_m)

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
        """Return the heights of cells [row0, row1) x [col0, col1)."""
        kept = self._kept
        heights = self._read(row0, row1, col0, col1) if kept is None else kept[row0:row1, col0:col1]
        place = self.frame.window(row0, row1, col0, col1)
        return Heightmap(heights, place, self.source, part=True, layers=self.layers)

    @cached_property
    def _kept(self) -> NDArray[np.float32] | None:
        rows, cols = self.frame.shape
        return self._read(0, rows, 0, cols) if rows * cols <= _KEPT_CELLS else None

    def _read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        heights = self.reader.read(self.scaling, slice(row0, row1), slice(col0, col1))
        return self.layers.over(heights, self.frame.window(row0, row1, col0, col1))

    def with_layers(self, layers: Layers) -> HeightmapFile:
        """Return the file with layers. As `Heightmap.with_layers`."""
        return replace(self, layers=layers)

    @property
    def data_hash(self) -> str:
        """SHA-256 (16 hex digits) of heights and frame, as `Heightmap.data_hash`."""
        return self._read_through[0]

    @property
    def known_share(self) -> float:
        """Share of cells whose height is known, 0..1."""
        return self._read_through[1]

    @cached_property
    def _read_through(self) -> tuple[str, float]:
        digest, known = hashlib.sha256(), 0
        for heights in self._strips():
            digest.update(np.ascontiguousarray(heights).data)
            known += int(np.count_nonzero(~np.isnan(heights)))
        digest.update(self.frame.identity.encode())
        if not known:
            raise HeightmapError("every cell of the heightmap is unknown: there is no ground to plan on")
        return digest.hexdigest()[:16], known / (self.frame.rows * self.frame.cols)

    def _strips(self) -> Iterator[NDArray[np.float32]]:
        if self._kept is not None:
            yield self._kept
            return
        step = max(1, _STRIP_CELLS // self.frame.cols)
        for row in range(0, self.frame.rows, step):
            yield self._read(row, min(row + step, self.frame.rows), 0, self.frame.cols)


def window_without_noise(ground: Ground, row0: int, row1: int, col0: int, col1: int) -> Heightmap:
    """Return the expected ground of cells [row0, row1) x [col0, col1), given the survey.

    Result: the same as that part of the whole map without noise.
    """
    if ground.noise.noise_m < LEAST_NOISE_M:
        return ground.window(row0, row1, col0, col1)
    rows, cols = ground.frame.shape
    length = ground.noise.length_m / ground.frame.resolution_m
    margin = margin_cells(length)
    top, left = max(row0 - margin, 0), max(col0 - margin, 0)
    around = ground.window(top, min(row1 + margin, rows), left, min(col1 + margin, cols))
    heights = denoised(around.heights, ground.noise.noise_m, length)[row0 - top : row1 - top, col0 - left : col1 - left]
    heights = ground.layers.over(heights, ground.frame.window(row0, row1, col0, col1))
    place, removed = ground.frame.window(row0, row1, col0, col1), hiding_noise_m(ground.noise.noise_m, length)
    noise: Any = {"given_noise_m": 0.0, "removed_noise_m": removed}
    return Heightmap(heights, place, ground.source, part=True, layers=ground.layers, **noise)


def overview(ground: Ground) -> Heightmap:
    """Return enough of a map to judge its slopes by.

    Result: the map itself up to 4 million cells; of a larger one, windows spread over it with unknown cells between
    them.
    """
    frame = ground.frame
    if frame.rows * frame.cols <= _SAMPLE_CELLS:
        return ground.window(0, frame.rows, 0, frame.cols)
    gutter = max(4, math.ceil(4.0 / frame.resolution_m))  # wider than any slope is judged over
    side = math.isqrt(_SAMPLE_CELLS) // _BLOCKS

    def _starts(length: int) -> list[tuple[int, int]]:
        count = min(_BLOCKS, max(1, length // side))
        wide = min(side, length)
        return [(int(at), int(at) + wide) for at in np.linspace(0, length - wide, count)]

    rows, cols = _starts(frame.rows), _starts(frame.cols)
    high, wide = (max(b - a for a, b in spans) + gutter for spans in (rows, cols))
    heights = np.full((high * len(rows), wide * len(cols)), np.nan, dtype=np.float32)
    for i, (row0, row1) in enumerate(rows):
        for j, (col0, col1) in enumerate(cols):
            part = ground.window(row0, row1, col0, col1).heights
            heights[i * high : i * high + row1 - row0, j * wide : j * wide + col1 - col0] = part
    spread = frame.window(0, heights.shape[0], 0, heights.shape[1])
    return Heightmap(heights, spread, ground.source, part=True)
