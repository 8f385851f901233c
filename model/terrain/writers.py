"""Write rasters as GeoTIFF: a heightmap, or bands on its frame."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioIOError
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap

_FULL_BYTES = 1_000_000  # a disk with less room is full: a block of a raster may have found none


def write_bands_geotiff(
    path: str | Path | None,
    bands: NDArray[np.float32],
    frame: GridFrame,
    *,
    descriptions: Sequence[str] | None = None,
    tags: Mapping[str, str] | None = None,
    quick: bool = False,
) -> bytes | None:
    """Write a compressed float32 GeoTIFF, NaN its no-data value. A file appears whole or not at all.

    `path`: the file, None returns its bytes instead; `bands` (n, rows, cols). Result: the file's content where `path`
    is None.
    """
    bands = np.asarray(bands, dtype=np.float32)
    if bands.ndim != 3 or bands.shape[1:] != frame.shape:
        raise HeightmapError(f"bands are {bands.shape}, but the frame is (n, {frame.rows}, {frame.cols})")
    if descriptions is not None and len(descriptions) != len(bands):
        raise HeightmapError(f"{len(bands)} bands need as many descriptions, got {len(descriptions)}")
    profile = {
        "driver": "GTiff",
        "width": frame.cols,
        "height": frame.rows,
        "count": len(bands),
        "dtype": "float32",
        "crs": frame.crs,
        "transform": Affine(frame.resolution_m, 0.0, frame.west_m, 0.0, -frame.resolution_m, frame.north_m),
        "nodata": float("nan"),
        **({"compress": "zstd", "zstd_level": 1} if quick else {"compress": "deflate"}),
        "predictor": 3,
        "interleave": "band",
        "bigtiff": "if_safer",
        # squares, so that a window of a big map is read without the rest of its rows
        **({"tiled": True, "blockxsize": 256, "blockysize": 256} if min(frame.shape) > 512 else {}),
    }

    def _fill(dataset: rasterio.io.DatasetWriter) -> None:
        dataset.write(bands)
        for index, text in enumerate(descriptions or (), start=1):
            dataset.set_band_description(index, text)
        if tags:
            dataset.update_tags(**tags)

    # A corner at (0, 0) with cells of 1 m looks to rasterio like no transform; GeoTIFF does keep it.
    with rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_CACHEMAX=128):
        if path is None:
            with MemoryFile() as memory:
                with memory.open(**profile) as dataset:
                    _fill(dataset)
                return bytes(memory.getbuffer())
        path = Path(path)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            with rasterio.open(str(partial), "w", **profile) as dataset:
                _fill(dataset)
            _refuse_a_full_disk(path)  # where closing a file failed, GDAL says so on its standard error only
            partial.replace(path)
        except RasterioIOError:
            _refuse_a_full_disk(path)
            raise
        finally:
            partial.unlink(missing_ok=True)
    return None


def _refuse_a_full_disk(path: Path) -> None:
    if shutil.disk_usage(path.parent).free < _FULL_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def write_geotiff(path: str | Path | None, heightmap: Heightmap, *, quick: bool = False) -> bytes | None:
    """Write a heightmap as a GeoTIFF of one band.

    `path`: the file, None returns its bytes instead. Result: the file's content where `path` is None.
    """
    return write_bands_geotiff(path, heightmap.heights[None], heightmap.frame, descriptions=["height [m]"], quick=quick)
