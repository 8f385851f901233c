"""Pictures whose colours are heights: Terrain-RGB and Terrarium tiles, and grey saved as three equal channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader
from rasterio.windows import Window

from joulemap.model.errors import HeightmapError

_EARTH_M = (-11_000.0, 9_000.0)
"""The Challenger Deep lies at -10,935 m, Everest at 8,849 m."""
_LOOKED_AT = 1_000  # rows and columns in the middle, by which an encoding is recognised
_CONTINUOUS = 0.9  # share of the places where the first channel changes, at which a ground steps by half of its worth


@dataclass(frozen=True)
class Colours:
    """An encoding: height = weights . (R, G, B) + offset.

    Attributes
    ----------
    name : str
        What people call it.
    weights : tuple of float
        Metres per count of each channel; all equal to 0 but the first where the three are one grey.
    offset_m : float
        Height of black [m].
    """

    name: str
    weights: tuple[float, float, float]
    offset_m: float

    @property
    def note(self) -> str:
        """What was done, for people."""
        r, g, b = self.weights
        return f"its colours were read as heights, {self.name}: {r:g} R + {g:g} G + {b:g} B {self.offset_m:+g} m"

    def heights(self, channels: NDArray) -> NDArray[np.float64]:
        """Return the heights of colours.

        `channels` (3, rows, cols): red, green and blue. Result (rows, cols): heights [m].
        """
        return np.tensordot(np.array(self.weights), channels, axes=1) + self.offset_m


ENCODINGS = (
    Colours("Terrain-RGB", (6553.6, 25.6, 0.1), -10_000.0),
    Colours("Terrarium", (256.0, 1.0, 1 / 256), -32_768.0),
)
"""Of the tiles of Mapbox and MapTiler, and of Mapzen and the terrain tiles on AWS."""


GREY = Colours("grey", (1.0, 0.0, 0.0), 0.0)
"""Three equal channels, as image editors write grey: counts, and no heights."""


def colours_of(dataset: DatasetReader, what: str) -> Colours | None:
    """Return how the colours of a picture are heights; None where it has no colours.

    Result: the encoding that makes a ground of them, or `GREY`.
    """
    kinds = dataset.colorinterp[:3]
    if set(dataset.dtypes) != {"uint8"} or kinds != (ColorInterp.red, ColorInterp.green, ColorInterp.blue):
        return None
    rows, cols = min(_LOOKED_AT, dataset.height), min(_LOOKED_AT, dataset.width)
    window = Window((dataset.width - cols) // 2, (dataset.height - rows) // 2, cols, rows)
    channels = dataset.read((1, 2, 3), window=window).astype(np.float64)
    known = dataset.read_masks(1, window=window) != 0
    if known.any() and (channels == channels[0]).all():
        return GREY
    for each in ENCODINGS:
        if _is_ground(each, channels, known):
            return each
    raise HeightmapError(
        f"{what} is a picture in colours which are no heights (Terrain-RGB and Terrarium are known): take the "
        "elevation model it was drawn from, or give `band` and `scale_m`"
    )


def _is_ground(encoding: Colours, channels: NDArray[np.float64], known: NDArray[np.bool_]) -> bool:
    """Whether heights are possible, and continuous where the first channel changes, so that the others carry over."""
    heights = np.where(known, encoding.heights(channels), np.nan)
    low, high = _EARTH_M
    if (
        not known.any()
        or np.nanmin(heights) < low
        or np.nanmax(heights) > high
        or np.nanmin(heights) == np.nanmax(heights)
    ):
        return False
    steps = [np.abs(np.diff(heights, axis=k))[np.diff(channels[0], axis=k) != 0] for k in (0, 1)]
    changes = np.concatenate(steps)
    changes = changes[~np.isnan(changes)]
    return not changes.size or float((changes < encoding.weights[0] / 2).mean()) >= _CONTINUOUS
