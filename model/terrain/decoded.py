"""What every heightmap format returns before it becomes a Heightmap, and the checks they share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model import ranges
from joulemap.model.errors import HeightmapError, TooLargeError

UNDECLARED = (-9999.0, -32767.0, -32768.0)
"""Values that surveys write for "no data". Met undeclared they are refused, never taken for ground."""

MAX_SIDE = 1_000_000
"""Most rows, and most columns, of a map: 1,000 km at 1 m."""

_MARKS_OF_UNKNOWN = (1e30, 3.41e38)  # the largest floats of 32 bits, as ArcGIS and Surfer write them

_PART_CELLS = 4_000_000
_MOST = 2**63  # numbers beyond this are no sizes, and Python does not write the longest of them

SAME_LENGTH = 1e-3
"""Relative difference of two lengths that still count as the same."""


@dataclass(frozen=True)
class Decoded:
    """Heights and their place, as a file states them."""

    heights: NDArray[np.float32]  # (rows, cols): Heights [m], row 0 in the north, NaN where unknown
    west_m: float | None = None  # Outer edges of the north-west cell [m], None where the file does not say
    north_m: float | None = None
    resolution_m: float | None = None  # Side of a cell [m], None where the file does not say
    crs: str | None = None  # "EPSG:n" or WKT, None where the file does not say
    notes: tuple[str, ...] = ()  # What is to be known of the file

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        rows, cols = self.heights.shape
        return rows, cols

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window, which are in metres already.

        Result (rows, cols): heights [m], NaN where unknown.
        """
        return self.heights[rows, cols]


@dataclass(frozen=True)
class Scaling:
    """How stored values become metres: height = value * scale_m + offset_m."""

    scale_m: float | None = None  # Metres per stored unit; None means 1, except where a format needs it said
    offset_m: float = 0.0  # Height of the stored value 0 [m]
    nodata: float | None = None  # Stored value of unknown cells, in addition to what the file declares
    cell_m: float | None = None  # Side of a cell that the user wants, for formats of points, which have none

    def __post_init__(self) -> None:
        if self.scale_m is not None and self.scale_m not in ranges.SCALE_M:
            raise HeightmapError(
                f"`scale_m` must be {ranges.SCALE_M} metres per count, got {self.scale_m}",
                value=str(self.scale_m),
                limit=[ranges.SCALE_M.low, ranges.SCALE_M.high],
            )
        if self.offset_m not in ranges.HEIGHT_M:
            raise HeightmapError(
                f"`offset_m` must be {ranges.HEIGHT_M} metres, got {self.offset_m}",
                value=str(self.offset_m),
                limit=[ranges.HEIGHT_M.low, ranges.HEIGHT_M.high],
            )

    def to_metres(
        self,
        values: NDArray,
        *,
        band_scale: float = 1.0,
        band_offset: float = 0.0,
        known: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Turn stored values into metres.

        Result: heights [m] in the shape of `values`, NaN where unknown.

        Large arrays are converted in parts, so that a big map needs no second copy of itself. Of unsigned integers
        of 8 or 16 bits each possible value is converted once.
        """
        found = self._by_table(values, band_scale, band_offset, known)
        if found is not None:
            return found
        if values.size <= _PART_CELLS or len(values) < 2:
            return self._part_to_metres(values, band_scale, band_offset, known)
        metres = np.empty(values.shape, dtype=np.float32)
        step = max(1, _PART_CELLS * len(values) // values.size)
        for start in range(0, len(values), step):
            part = slice(start, start + step)
            mask = None if known is None else known[part]
            metres[part] = self._part_to_metres(values[part], band_scale, band_offset, mask)
        return metres

    def _by_table(
        self, values: NDArray, band_scale: float, band_offset: float, known: NDArray[np.bool_] | None
    ) -> NDArray[np.float32] | None:
        """The metres of many small unsigned integers; None where there are few, or where some may be refused."""
        kind = values.dtype
        if kind.kind != "u" or kind.itemsize > 2 or values.size <= 256**kind.itemsize:
            return None
        try:
            table = self._part_to_metres(np.arange(256**kind.itemsize, dtype=kind), band_scale, band_offset, None)
        except HeightmapError:
            return None
        metres: NDArray[np.float32] = table[values]
        if known is not None:
            metres[~known] = np.nan
        return metres

    def _part_to_metres(
        self, values: NDArray, band_scale: float, band_offset: float, known: NDArray[np.bool_] | None
    ) -> NDArray[np.float32]:
        if not (math.isfinite(band_scale) and band_scale != 0.0 and math.isfinite(band_offset)):
            raise HeightmapError(f"the file scales its heights by {band_scale} and {band_offset}: it is corrupt")
        unknown = np.zeros(values.shape, dtype=bool)
        if values.dtype.kind == "f":
            unknown = np.isnan(values)
            with np.errstate(invalid="ignore", over="ignore"):
                size = np.abs(values)
                unknown |= (size > _MARKS_OF_UNKNOWN[0]) & (size < _MARKS_OF_UNKNOWN[1])
        if known is not None:
            unknown |= ~known
        if self.nodata is not None:
            unknown |= values == self.nodata
        for suspect in UNDECLARED:
            if values.dtype.kind != "u" and ((values == suspect) & ~unknown).any():
                raise HeightmapError(
                    f"some cells hold {suspect:g}, the usual mark of an unknown height, but the file does not declare "
                    f"it: give `nodata` as {suspect:g} (or `rio edit-info FILE --nodata {suspect:g}` once)",
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
        limit = ranges.HEIGHT_M.high
        too_far = np.abs(metres) > limit
        if too_far.any():
            worst = float(metres[too_far][0])
            raise HeightmapError(
                f"the file holds a height of {worst:g} m, beyond {limit:g} m: an undeclared no-data value "
                "(give its value as `nodata`) or a wrong scale (`scale_m`)",
                value=str(worst),
                limit=limit,
            )
        return metres.astype(np.float32, copy=False)


def check_cells(rows: int, cols: int, max_cells: int, *, what: str = "the file") -> None:
    """Refuse a declared size before memory is allocated for it."""
    if not (1 <= rows <= _MOST and 1 <= cols <= _MOST):
        size = f"{ranges.short(rows)} x {ranges.short(cols)}"
        if min(rows, cols) < 1:
            raise HeightmapError(f"{what} declares {size} cells: there is nothing in it", declared=size, limit=2)
        raise TooLargeError(
            f"{what} declares {size} cells, more than the limit of {max_cells}", declared=size, limit=max_cells
        )
    if rows * cols > max_cells:
        raise TooLargeError(
            f"{what} declares {rows} x {cols} = {rows * cols} cells, more than the limit of {max_cells}",
            cells=rows * cols,
            limit=max_cells,
        )
    if min(rows, cols) < 2:
        raise HeightmapError(
            f"a heightmap needs at least 2 x 2 cells, {what} declares {rows} x {cols}", rows=rows, cols=cols, limit=2
        )
    if max(rows, cols) > MAX_SIDE:
        raise TooLargeError(
            f"{what} declares {rows} x {cols} cells, and the limit of a side is {MAX_SIDE}",
            cells_of_a_side=max(rows, cols),
            limit=MAX_SIDE,
        )
