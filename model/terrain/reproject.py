"""A heightmap in any coordinate reference system, rotated or with cells that are not square, resampled to true metres.

GDAL's warper reads the file by windows, so that memory is bounded whatever its size. Unknown cells stay unknown:
heights are interpolated between known ones only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.cut_out import cells_of
from joulemap.model.terrain.decoded import Scaling, check_cells
from joulemap.model.terrain.formats import raster as rasters
from joulemap.model.terrain.formats.contract import HeightmapFormat, WindowReader
from joulemap.model.terrain.formats.gdal import GDAL_OPTIONS
from joulemap.model.terrain.formats.raster_band import Raster
from joulemap.model.terrain.stated_frame import Reading
from joulemap.model.terrain.target_grid import EDGE_POINTS, choose_crs, moved, new_grid, short_name

_TOLERANCE_CELLS = 0.01  # of the places between which GDAL interpolates its transformation
_COARSER = 2.0  # from this ratio of cells on, heights are averaged and not interpolated
_WARP_MB = 64
_SCAN_CELLS = 4_000_000


@dataclass(frozen=True)
class Warped:
    """A file as it is on the new grid: what is known without its heights, and the heights of any window."""

    raster: Raster  # The file, or a GeoTIFF of its heights
    source_crs: str | None  # Before and after; None where the file names none
    crs: str | None
    source_transform: Affine  # Of the file's own grid
    transform: Affine  # Of the new grid
    shape: tuple[int, int]  # Rows and columns of the new grid
    resampling: Resampling  # How heights are interpolated
    nodata: float | None  # Stored value that means unknown
    undeclared: bool  # Whether nobody said which value that is, so that the usual ones are looked for
    notes: tuple[str, ...]  # What was done, for people

    @property
    def west_m(self) -> float:
        """Western edge [m]."""
        return float(self.transform.c)

    @property
    def north_m(self) -> float:
        """Northern edge [m]."""
        return float(self.transform.f)

    @property
    def resolution_m(self) -> float:
        """Side of a cell [m]."""
        return float(self.transform.a)

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window. Result (rows, cols): heights [m], NaN where unknown."""
        heights = np.empty((rows.stop - rows.start, cols.stop - cols.start), np.float32)
        step = max(1, _SCAN_CELLS // max(1, heights.shape[1]))
        with self.raster.dataset() as dataset, self._warped(dataset) as vrt:
            scale, offset = self.raster.scales(dataset, scaling)
            for row in range(0, heights.shape[0], step):
                high = min(step, heights.shape[0] - row)
                window = Window(cols.start, rows.start + row, heights.shape[1], high)
                if self.undeclared:
                    self._refuse_undeclared(dataset, scaling, window)
                values = vrt.read(self.raster.band, window=window)
                known = ~np.isnan(values)  # a mask would be warped once more
                heights[row : row + high] = scaling.to_metres(values, band_scale=scale, band_offset=offset, known=known)
        return heights

    def _refuse_undeclared(self, dataset: DatasetReader, scaling: Scaling, window: Window) -> None:
        """Interpolation would hide values such as -9999; so the stored values under a window are looked at first."""
        along = np.linspace(0.0, 1.0, EDGE_POINTS)
        col = window.col_off + window.width * np.concatenate([along, along, 0 * along, 0 * along + 1])
        row = window.row_off + window.height * np.concatenate([0 * along, 0 * along + 1, along, along])
        x, y = moved(self.crs, self.source_crs, self.transform, col, row)
        there = ~self.source_transform
        source_col, source_row = there.a * x + there.b * y + there.c, there.d * x + there.e * y + there.f
        spans = []
        for values, most in ((source_row, dataset.height), (source_col, dataset.width)):
            known = values[np.isfinite(values)]
            if not known.size:
                return
            spans.append(slice(max(0, math.floor(known.min()) - 2), min(most, math.ceil(known.max()) + 2)))
        rows, cols = spans
        if rows.stop <= rows.start or cols.stop <= cols.start:
            return
        step = max(1, _SCAN_CELLS // (cols.stop - cols.start))
        for first in range(rows.start, rows.stop, step):
            self.raster.read_from(dataset, scaling, slice(first, min(first + step, rows.stop)), cols)

    @contextmanager
    def _warped(self, dataset: DatasetReader) -> Iterator[WarpedVRT]:
        crs = _usable(self.source_crs)
        # with a scale of 1 GDAL's kernel is the plain bilinear one; a wider one does not reproduce a slope
        with WarpedVRT(
            dataset,
            src_crs=crs,
            src_transform=self.source_transform,
            crs=_usable(self.crs),
            transform=self.transform,
            width=self.shape[1],
            height=self.shape[0],
            resampling=self.resampling,
            src_nodata=self.nodata,
            nodata=math.nan,
            dtype="float64" if self.raster.dtype in ("float64", "int32", "uint32") else "float32",
            add_alpha=False,
            tolerance=_TOLERANCE_CELLS,
            warp_mem_limit=_WARP_MB,
            **({"XSCALE": "1", "YSCALE": "1"} if self.resampling is Resampling.bilinear else {}),
        ) as vrt:
            yield vrt


def reproject_file(
    file: SourceFile, kind: HeightmapFormat, reading: Reading, to: str, *, max_cells: int, max_cells_whole: int
) -> tuple[Warped, Scaling]:
    """Return a file as it is on a north-up grid of square cells of true metres."""
    scaling, band, resolution_m, crs = reading.scaling, reading.band, reading.resolution_m, reading.crs
    if kind.code is rasters:
        raster = rasters.open_windows(file, scaling, band=band, north_up=False)
    if kind.code is not rasters or raster.colours is not None or raster.transform.is_identity:
        whole = rasters.open_windows(file, scaling, band=band) if kind.code is rasters else None
        decoded = whole or kind.code.decode(file, scaling, max_cells=max_cells_whole, band=band)
        check_cells(*decoded.shape, max_cells_whole, what=file.name)
        if decoded.resolution_m is None and resolution_m is not None:
            side, resolution_m = resolution_m, None
        elif decoded.resolution_m is None:
            raise HeightmapError("the file does not say how large a cell is: give `resolution_m`")
        else:
            side = decoded.resolution_m
        content = _as_geotiff(decoded, scaling, side, reading.west_m, reading.north_m)
        crs, scaling = decoded.crs or crs, Scaling()
        made = rasters.open_windows(SourceFile(content, file.name, content[:4], alone=True), scaling, north_up=False)
        raster = replace(made, notes=decoded.notes)
    rows, cols = raster.shape
    own, transform = raster.own_crs, raster.transform
    if own is not None and crs is not None and known_crs(own) != known_crs(crs):
        raise HeightmapError(
            f"`crs` {crs[:80]} was given, but the file says {short_name(own)}: leave it out", crs=crs[:80]
        )
    source_crs = own or crs
    nodata = _nodata(raster, scaling)
    undeclared = raster.nodata is None and scaling.nodata is None
    in_feet = own is not None and abs(_unit_m(own) - 1.0) > 1e-9
    unit_unknown = in_feet and not raster.unit_said and scaling.scale_m is None
    part = transform
    if reading.window is not None:
        cells = cells_of(reading.window, source_crs, transform, (rows, cols))
        (x,), (y,) = moved(None, None, transform, np.array([cells.col0]), np.array([cells.row0]))
        part, (rows, cols) = Affine(transform.a, transform.b, x, transform.d, transform.e, y), cells.shape
    target, why = choose_crs(source_crs, part, rows, cols, to)
    grid, shape, size = new_grid(source_crs, target, part, rows, cols, resolution_m)
    check_cells(*shape, max_cells, what=f"{file.name}, reprojected to cells of {grid.a:g} m,")
    what = "" if reading.window is None else "a window of the file was "
    note = f"{what}reprojected from {short_name(source_crs)} to {short_name(target)}{why}, with cells of {grid.a:g} m"
    notes = [note, *raster.notes]
    if unit_unknown:
        notes.append(
            "the map is in feet and does not say the unit of its heights, which were taken for metres: give `scale_m` "
            "as 0.3048 if they are feet, else as 1"
        )
    between = Resampling.average if grid.a > _COARSER * size else Resampling.bilinear
    resampling = Resampling.nearest if reading.nearest else between
    warped = Warped(raster, source_crs, target, transform, grid, shape, resampling, nodata, undeclared, tuple(notes))
    return warped, Scaling(scaling.scale_m, scaling.offset_m, None)


def _usable(crs: str | None) -> CRS:
    """A map without a CRS is resampled in its own plane; which CRS GDAL then gets makes no difference."""
    return known_crs(crs if crs is not None else "EPSG:32630")


def _unit_m(crs: str) -> float:
    """Metres per unit of a CRS; 1 where it is in degrees."""
    known = known_crs(crs)
    return float(known.linear_units_factor[1]) if known.is_projected else 1.0


def _nodata(raster: Raster, scaling: Scaling) -> float | None:
    """The one stored value that means unknown; NaN where none is declared and values may be NaN."""
    declared = raster.nodata
    if scaling.nodata is not None:
        if declared is not None and declared != scaling.nodata and not math.isnan(declared):
            raise HeightmapError(
                f"`nodata` {scaling.nodata:g} was given, but the file declares {declared:g}: with `reproject` only one "
                "value can mean unknown",
                nodata=scaling.nodata,
            )
        return scaling.nodata
    return math.nan if declared is None and np.dtype(raster.dtype).kind == "f" else declared


def _as_geotiff(decoded: WindowReader, scaling: Scaling, side: float, west_m: float, north_m: float | None) -> bytes:
    """Heights of any format as the bytes of a GeoTIFF, for GDAL's warper."""
    rows, cols = decoded.shape
    west = decoded.west_m if decoded.west_m is not None else west_m
    north = next((edge for edge in (decoded.north_m, north_m) if edge is not None), rows * side)
    with rasterio.Env(**GDAL_OPTIONS), rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=cols,
            height=rows,
            count=1,
            dtype="float32",
            nodata=math.nan,
            transform=Affine(side, 0.0, west, 0.0, -side, north),
            BIGTIFF="IF_SAFER",
        ) as dataset:
            dataset.write(decoded.read(scaling, slice(0, rows), slice(0, cols)), 1)
        return bytes(memory.getbuffer())
