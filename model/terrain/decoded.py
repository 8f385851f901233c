"""What every decoder hands back before it becomes a Heightmap, and the checks they share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, TooLargeError

UNDECLARED = (-9999.0, -32767.0, -32768.0)
"""Values that surveys write for "no data". Met undeclared they are refused, never taken for ground."""

HEIGHT_LIMIT_M = 50_000.0
"""No ground is farther from zero than this; what is, is a no-data value or a wrong scale."""


@dataclass(frozen=True)
class Decoded:
    """Heights as a file states them. heights : (rows, cols) float32 [m], row 0 north, NaN unknown.

    west_m, north_m, resolution_m, crs : None where the file does not say.
    """

    heights: NDArray[np.float32]
    west_m: float | None = None
    north_m: float | None = None
    resolution_m: float | None = None
    crs: str | None = None


@dataclass(frozen=True)
class Scaling:
    """How stored values become metres: height = value * scale_m + offset_m; `nodata` is the value of unknown cells."""

    scale_m: float | None = None
    offset_m: float = 0.0
    nodata: float | None = None

    def __post_init__(self) -> None:
        if self.scale_m is not None and not (math.isfinite(self.scale_m) and self.scale_m > 0):
            raise HeightmapError(f"scale_m must be a positive number of metres per count, got {self.scale_m}")
        if not math.isfinite(self.offset_m):
            raise HeightmapError(f"offset_m must be a finite number of metres, got {self.offset_m}")

    def to_metres(
        self,
        values: NDArray,
        *,
        band_scale: float = 1.0,
        band_offset: float = 0.0,
        known: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Stored values (any real type and shape) as float32 metres; NaN where `known` is false or the value is nodata.

        band_scale, band_offset : the file's own scaling, applied first. Raises HeightmapError on an undeclared
        no-data value and on heights beyond HEIGHT_LIMIT_M.
        """
        if not (math.isfinite(band_scale) and band_scale != 0.0 and math.isfinite(band_offset)):
            raise HeightmapError(f"the file scales its heights by {band_scale} and {band_offset}: it is corrupt")
        unknown = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, dtype=bool)
        if known is not None:
            unknown |= ~known
        if self.nodata is not None:
            unknown |= values == self.nodata
        for suspect in UNDECLARED:
            if values.dtype.kind != "u" and ((values == suspect) & ~unknown).any():
                raise HeightmapError(
                    f"some cells hold {suspect:g}, the usual mark of an unknown height, but the file does not declare "
                    f"it: give nodata={suspect:g} (or `gdal_edit.py -a_nodata {suspect:g} FILE`)",
                    value=suspect,
                )
        scale = band_scale * (1.0 if self.scale_m is None else self.scale_m)
        offset = band_offset * (1.0 if self.scale_m is None else self.scale_m) + self.offset_m
        if values.dtype == np.float32 and scale == 1.0 and offset == 0.0:
            metres = values.copy()
        else:
            with np.errstate(invalid="ignore", over="ignore"):  # what overflows is refused below
                metres = np.multiply(values, scale, dtype=np.float64)
                metres += offset
        metres[unknown] = np.nan
        too_far = np.abs(metres) > HEIGHT_LIMIT_M
        if too_far.any():
            worst = float(metres[too_far][0])
            raise HeightmapError(
                f"the file holds a height of {worst:g} m, beyond {HEIGHT_LIMIT_M:g} m: an undeclared no-data value "
                "(give nodata=VALUE) or a wrong scale",
                value=str(worst),
                limit=HEIGHT_LIMIT_M,
            )
        return metres.astype(np.float32, copy=False)


def check_cells(rows: int, cols: int, max_cells: int, *, what: str = "the file") -> None:
    """Refuse a declared size before anything of it is allocated. Raises TooLargeError, or HeightmapError when empty."""
    if rows < 1 or cols < 1:
        raise HeightmapError(f"{what} declares {rows} x {cols} cells: there is nothing in it", rows=rows, cols=cols)
    if rows * cols > max_cells:
        raise TooLargeError(
            f"{what} declares {rows} x {cols} = {rows * cols} cells, more than the limit of {max_cells}",
            cells=rows * cols,
            limit=max_cells,
        )
