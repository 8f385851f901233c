"""What GDAL's formats share: a dataset cut off from the network and from files beside it, read stripe by stripe."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader, MemoryFile
from rasterio.windows import Window

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.decoded import Scaling

GDAL_OPTIONS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no .aux.xml, .ovr, .msk, world files
    "GDAL_PAM_ENABLED": "NO",
    "PROJ_NETWORK": "OFF",
    "GDAL_CACHEMAX": 128,  # [MB]
}
"""Settings of GDAL and PROJ under which every file and every CRS is read."""

_STRIPE_CELLS = 4_000_000  # decoded at a time, so that a big map needs no second copy of itself
_FUNCTION = re.compile(r"\b(TIFF|GTiff|JPEG|PNG|HFA|VSI|CPL|GDAL|OGR)\w*:\s*")
"""Names of functions inside GDAL, which its messages begin with."""


def is_gdal_error(error: Exception) -> bool:
    """Decide whether an exception is a failure of GDAL or PROJ.

    Parameters
    ----------
    error : Exception
        What a call of rasterio raised.

    Returns
    -------
    bool
        True for rasterio's own classes.

    Notes
    -----
    Some properties of a dataset (`colorinterp` is one) raise GDAL's errors in classes which `rasterio.errors` does not
    export. They are recognised by the package that defines them.
    """
    return type(error).__module__.partition(".")[0] == "rasterio"


@contextmanager
def opened(source: Path | bytes, driver: str) -> Iterator[DatasetReader]:
    """Open a dataset with one driver alone.

    Parameters
    ----------
    source : Path or bytes
        A file, or its bytes.
    driver : str
        GDAL's name of the format: GTiff or PNG.

    Yields
    ------
    DatasetReader
        The open dataset.

    Raises
    ------
    HeightmapError
        Where GDAL fails, also later while the dataset is read.
    """
    name = {"GTiff": "GeoTIFF", "PNG": "PNG image"}[driver]
    with warnings.catch_warnings(), rasterio.Env(**GDAL_OPTIONS):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            if isinstance(source, bytes):
                with MemoryFile(source) as memory, memory.open(driver=driver) as dataset:
                    yield dataset
            else:
                with rasterio.open(str(source), driver=driver) as dataset:
                    yield dataset
        except Exception as error:
            if not (is_gdal_error(error) or isinstance(error, (UnicodeDecodeError, OSError))):
                raise
            cause = error.__cause__ or error
            if type(cause).__name__ == "CPLE_OutOfMemoryError" or "cannot allocate" in str(cause):
                raise TooLargeError(
                    f"the {name} asks for more memory than there is for one of its blocks: write it in smaller ones "
                    "(gdal_translate -co TILED=YES IN OUT)"
                ) from error
            words = _FUNCTION.sub("", str(cause))[:300]
            raise HeightmapError(f"the {name} is truncated or corrupt: {words}") from error


def read_band(dataset: DatasetReader, band: int, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
    """Read a window of one band as metres.

    Parameters
    ----------
    dataset : DatasetReader
        An open dataset.
    band : int
        Number of the band, from 1.
    scaling : Scaling
        How stored values become metres, after the file's own scale and offset.
    rows, cols : slice
        The window, in the file's own order of rows.

    Returns
    -------
    ndarray of float32, (rows, cols)
        Heights [m], NaN where the file's mask or no-data value says unknown.
    """
    masked = MaskFlags.all_valid not in dataset.mask_flag_enums[band - 1]
    wide = cols.stop - cols.start
    heights = np.empty((rows.stop - rows.start, wide), dtype=np.float32)
    block_rows = dataset.block_shapes[band - 1][0]
    step = max(1, _STRIPE_CELLS // (wide * block_rows)) * block_rows
    for row in range(rows.start, rows.stop, step):
        window = Window(cols.start, row, wide, min(step, rows.stop - row))
        values = dataset.read(band, window=window)
        known = dataset.read_masks(band, window=window) != 0 if masked else None
        heights[row - rows.start : row - rows.start + step] = scaling.to_metres(
            values, band_scale=dataset.scales[band - 1], band_offset=dataset.offsets[band - 1], known=known
        )
    return heights
