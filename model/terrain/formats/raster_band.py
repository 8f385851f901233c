"""One band of a raster, or heights in its colours: what is known without the heights, and the heights of any window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import MaskFlags
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.formats.colours import Colours
from joulemap.model.terrain.formats.gdal import opened

_STRIPE_CELLS = 4_000_000  # decoded at a time, so that a big map needs no second copy of itself


@dataclass(frozen=True)
class Raster:
    """One band of a raster: what the file states without its heights, and the heights of any window.

    Attributes
    ----------
    source : SourceFile
        The file.
    drivers : tuple of str
        With which it is opened.
    what : str
        What messages call it.
    part : str
        Name of its variable, where it has several.
    band : int
        Number of the band, from 1.
    shape : tuple of int
        Rows and columns.
    transform : Affine
        From (column, row) to x, y; the identity where the file does not say.
    own_crs : str or None
        WKT of the file.
    crs : str or None
        "EPSG:n" or WKT of a grid of true metres.
    dtype : str
        Of the stored values.
    nodata : float or None
        Stored value of unknown cells.
    factor : float
        Metres per unit of the heights.
    unit_said : bool
        Whether the file says the unit of its heights.
    colours : Colours or None
        How colours are heights.
    notes : tuple of str
        What is to be known of the file.
    """

    source: SourceFile
    drivers: tuple[str, ...]
    what: str
    part: str
    band: int
    shape: tuple[int, int]
    transform: Affine
    own_crs: str | None
    crs: str | None
    dtype: str
    nodata: float | None
    factor: float
    unit_said: bool
    colours: Colours | None
    notes: tuple[str, ...]

    @property
    def resolution_m(self) -> float | None:
        """Side of a cell [m], None where the file does not say."""
        return None if self.transform.is_identity else self.transform.a

    @property
    def west_m(self) -> float | None:
        """Western edge [m], None where the file does not say."""
        return None if self.transform.is_identity else self.transform.c

    @property
    def north_m(self) -> float | None:
        """Northern edge [m], None where the file does not say."""
        south_up = self.transform.e * self.shape[0] if self._flip else 0.0
        return None if self.transform.is_identity else self.transform.f + south_up

    @property
    def _flip(self) -> bool:
        return self.transform.e > 0 and not self.transform.is_identity

    @contextmanager
    def dataset(self) -> Iterator[DatasetReader]:
        """Open the file once more, for as long as the block runs."""
        with opened(self.source, self.drivers, what=self.what, part=self.part) as dataset:
            yield dataset

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window. Result (rows, cols): heights [m], NaN where unknown."""
        with self.dataset() as dataset:
            if not self._flip:
                return self.read_from(dataset, scaling, rows, cols)
            high = self.shape[0]
            heights = self.read_from(dataset, scaling, slice(high - rows.stop, high - rows.start), cols)
            return np.ascontiguousarray(heights[::-1])

    def read_from(self, dataset: DatasetReader, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window of the open file.

        Result (rows, cols): heights [m], NaN where the file's mask or no-data value says unknown.
        """
        k = self.band - 1
        bands = (1, 2, 3) if self.colours is not None else self.band
        masked = MaskFlags.all_valid not in dataset.mask_flag_enums[k]
        scale, offset = self.scales(dataset, scaling)
        if scaling.nodata is None and dataset.nodatavals[k] is None:
            scaling = replace(scaling, nodata=self.nodata)
        wide = cols.stop - cols.start
        heights = np.empty((rows.stop - rows.start, wide), dtype=np.float32)
        block_rows = dataset.block_shapes[k][0]
        step = max(1, _STRIPE_CELLS // (wide * block_rows)) * block_rows
        for row in range(rows.start, rows.stop, step):
            window = Window(cols.start, row, wide, min(step, rows.stop - row))
            values = dataset.read(bands, window=window)
            if self.colours is not None:
                values = self.colours.heights(values)
            known = dataset.read_masks(self.band, window=window) != 0 if masked else None
            heights[row - rows.start : row - rows.start + step] = scaling.to_metres(
                values, band_scale=scale, band_offset=offset, known=known
            )
        return heights

    def scales(self, dataset: DatasetReader, scaling: Scaling) -> tuple[float, float]:
        """Return the file's own scale and offset [m]; the unit counts only where the user gave no metres per unit."""
        factor = 1.0 if scaling.scale_m is not None else self.factor
        return dataset.scales[self.band - 1] * factor, dataset.offsets[self.band - 1] * factor
