"""Rasters that GDAL reads: one band as heights, or a picture whose colours are heights; whole or by windows."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.coordinate_systems import crs_name, flat_crs, warp_command
from joulemap.model.terrain.decoded import MAX_SIDE, SAME_LENGTH, Scaling, check_cells
from joulemap.model.terrain.formats import FORMATS, formats_in_words
from joulemap.model.terrain.formats.ascii_text import check_ascii_grid
from joulemap.model.terrain.formats.colours import GREY, Colours, colours_of
from joulemap.model.terrain.formats.gdal import ALONE, BESIDE, opened
from joulemap.model.terrain.units import height_unit

_MARKS: dict[bytes, tuple[str, str]] = {  # first bytes -> driver, and what messages call the file
    b"II*\0": ("GTiff", "GeoTIFF"),
    b"MM\0*": ("GTiff", "GeoTIFF"),
    b"II+\0": ("GTiff", "GeoTIFF"),
    b"MM\0+": ("GTiff", "GeoTIFF"),
    b"\x89PNG\r\n\x1a\n": ("PNG", "PNG image"),
    b"EHFA_HEADER_TAG": ("HFA", "ERDAS image"),
    b"CDF\x01": ("netCDF", "netCDF file"),
    b"CDF\x02": ("netCDF", "netCDF file"),
    b"CDF\x05": ("netCDF", "netCDF file"),
    b"\x89HDF": ("netCDF", "netCDF-4 or HDF5 file"),
    b"DSAA": ("GSAG", "Surfer grid"),
    b"DSBB": ("GSBG", "Surfer grid"),
    b"DSRB": ("GS7BG", "Surfer grid"),
    b"UHL1": ("DTED", "DTED file"),
    b"P2": ("PNM", "PGM image"),
    b"P5": ("PNM", "PGM image"),
    b"<VRTDataset": ("VRT", "VRT"),
    b"north:": ("GRASSASCIIGrid", "GRASS ASCII grid"),
    **dict.fromkeys(
        (
            b"ncols",
            b"nrows",
            b"xllcorner",
            b"yllcorner",
            b"xllcenter",
            b"yllcenter",
            b"cellsize",
            b"dx",
            b"nodata_value",
        ),
        ("AAIGrid", "ASCII grid"),
    ),
}
_PICTURES = ("PNG", "PNM", "JPEG", "BMP", "WEBP", "GIF")  # their numbers are counts
_WITH_HEADER = (".bil", ".bip", ".bsq", ".flt", ".sdat", ".dat", ".rst", ".gri", ".raw")
_VARIABLES = ("elevation", "z", "height", "dem", "topo", "altitude", "band1", "heights")
_MAX_BLOCK_BYTES = 1 << 30
_STRIPE_CELLS = 4_000_000  # decoded at a time, so that a big map needs no second copy of itself
_MAX_VRT_BYTES = 10_000_000
_MOST_VRTS = 8  # one within the other
_NAMES = re.compile(
    r"<(?:SourceFilename|SourceDataset)\b[^>]*>([^<]*)|(/vsi|CDATA|(?:SourceFilename|SourceDataset)\s*=)"
)


def recognise(head: bytes, name: str) -> bool:
    """Take any file that no other format has taken: GDAL decides by all of its content.

    Parameters
    ----------
    head : bytes
        Not used.
    name : str
        Not used.

    Returns
    -------
    bool
        True.
    """
    return True


def open_windows(
    source: SourceFile,
    scaling: Scaling,
    *,
    band: int | None = None,
    max_cells: int = MAX_SIDE * MAX_SIDE,
    north_up: bool = True,
) -> Raster:
    """Open a raster of any size for reading by windows.

    Parameters
    ----------
    source : SourceFile
        The file.
    scaling : Scaling
        How stored values become metres; a picture needs its scale.
    band : int, optional
        The band with the heights, from 1; needed where there are several.
    max_cells : int, optional
        Largest number of cells.
    north_up : bool, optional
        Whether it must lie on a north-up grid of square cells of true metres.

    Returns
    -------
    Raster
        Its place, and its heights window by window.

    Raises
    ------
    HeightmapError
        On a grid or a CRS that is not of true metres, blocks that were never written, several bands, a file that names
        others and was sent alone, a truncated or corrupt file.
    TooLargeError
        If it declares more than `max_cells` cells.
    """
    driver, what = _marked(source.head) or ("", "")
    if source.alone and (driver == "VRT" or source.head.startswith(b"\x89HDF")):
        raise HeightmapError(
            f"{source.name} is a {what}, which names other files or may do so; here one file is read and no other: "
            f"convert it where they lie (gdal_translate {source.name} map.tif), or use the command line there"
        )
    if driver == "VRT":
        assert isinstance(source.place, Path)
        _check_names(source.place, _MOST_VRTS)
    if driver == "AAIGrid":
        source = check_ascii_grid(source, max_cells)
    if what:
        drivers = ("netCDF", "HDF5", "BAG", "S102") if source.head.startswith(b"\x89HDF") else (driver,)
        return _opened(source, drivers, f"the {what}", scaling, band, max_cells, north_up)
    try:
        return _opened(source, ALONE if source.alone else BESIDE, source.name, scaling, band, max_cells, north_up)
    except HeightmapError as error:
        if "not recognized as being in a supported file format" not in error.message:
            raise
        suffix = Path(source.name).suffix.lower()
        if suffix in _WITH_HEADER:
            raise HeightmapError(
                f"{source.name} cannot be read without its header (.hdr, .sgrd, .rdc), which was not found: put it "
                "beside the file, or both into one zip"
            ) from error
        more = " that names no other file (gdal_translate makes a GeoTIFF of others)" if source.alone else ""
        words = "is not what its name says: there is no raster in its content" + more
        if suffix not in (each for one in FORMATS for each in one.suffixes):
            words = f"is not a heightmap: {formats_in_words()} are read"
        raise HeightmapError(f"{source.name} {words}", name=source.name) from error


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
        """Return the heights of a window.

        Parameters
        ----------
        scaling : Scaling
            How values become metres, after the file's own scale, offset and unit.
        rows, cols : slice
            The window; row 0 is the northern one.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Heights [m], NaN where unknown.

        Raises
        ------
        HeightmapError
            If the window cannot be read.
        """
        with self.dataset() as dataset:
            if not self._flip:
                return self.read_from(dataset, scaling, rows, cols)
            high = self.shape[0]
            heights = self.read_from(dataset, scaling, slice(high - rows.stop, high - rows.start), cols)
            return np.ascontiguousarray(heights[::-1])

    def read_from(self, dataset: DatasetReader, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window of the open file.

        Parameters
        ----------
        dataset : DatasetReader
            The file, open.
        scaling : Scaling
            How values become metres.
        rows, cols : slice
            The window, in the file's own order of rows.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Heights [m], NaN where the file's mask or no-data value says unknown.
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
        """Return the file's own scale and offset [m]; the unit counts only where the user gave no metres per unit.

        Parameters
        ----------
        dataset : DatasetReader
            The file, open.
        scaling : Scaling
            What the user gave.

        Returns
        -------
        tuple of float
            Metres per stored unit, and the height of the stored value 0 [m].
        """
        factor = 1.0 if scaling.scale_m is not None else self.factor
        return dataset.scales[self.band - 1] * factor, dataset.offsets[self.band - 1] * factor


def _marked(head: bytes) -> tuple[str, str] | None:
    plain = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if plain.startswith(b"<?xml"):
        plain = plain.partition(b"?>")[2].lstrip()
    for mark, found in _MARKS.items():
        if head.startswith(mark) or (mark.lower() == mark and plain.lower().startswith(mark)):
            return found
    return _MARKS[b"<VRTDataset"] if plain.startswith(b"<VRTDataset") else None


def _opened(
    source: SourceFile,
    drivers: tuple[str, ...],
    what: str,
    scaling: Scaling,
    band: int | None,
    max_cells: int,
    north_up: bool,
) -> Raster:
    with opened(source, drivers, what=what) as dataset:
        if dataset.count:
            return _header(dataset, source, what, scaling, band, max_cells, north_up)
        driver, parts = dataset.driver, [name.rpartition(":")[2].strip("/") for name in dataset.subdatasets]
    if not parts:
        raise HeightmapError(f"{what} holds no raster")
    if band is not None and band > len(parts):
        raise HeightmapError(f"{what} has {len(parts)} variables: `band` is 1 to {len(parts)}")
    named = [part for part in parts if part.rpartition("/")[2].lower() in _VARIABLES]
    if band is None and len(named) != 1:
        raise HeightmapError(
            f"{what} has several variables: give `band`, the number of the one with the heights, of "
            f"{', '.join(f'{k} {part}' for k, part in enumerate(parts, 1))[:300]}"
        )
    part = named[0] if band is None else parts[band - 1]
    with opened(source, (driver,), what=what, part=part) as dataset:
        return _header(dataset, source, what, scaling, None, max_cells, north_up, part)


def _header(
    dataset: DatasetReader,
    source: SourceFile,
    what: str,
    scaling: Scaling,
    band: int | None,
    max_cells: int,
    north_up: bool,
    part: str = "",
) -> Raster:
    rows, cols = dataset.shape
    check_cells(rows, cols, max_cells, what=what)
    picture = dataset.driver in _PICTURES
    colours = colours_of(dataset, what) if band is None else None
    if colours is GREY:
        colours, picture, band = None, True, 1
    elif colours is not None and scaling.scale_m is not None:
        raise HeightmapError(f"{what} holds heights in its colours, {colours.name}: leave `scale_m` out")
    band = 1 if colours is not None else _checked_band(dataset, band, what)
    if picture and colours is None and scaling.scale_m is None:
        raise HeightmapError(
            f"{what} is a picture: it holds counts, not metres: give `scale_m`, the metres per count (and `offset_m`, "
            "the height of count 0)"
        )
    whole_crs = dataset.crs.to_wkt() if dataset.crs else None
    own = flat_crs(whole_crs) if whole_crs else None
    unit = height_unit(dataset.units[band - 1], whole_crs, what)
    notes = [] if colours is None else [colours.note]
    if unit.note and scaling.scale_m is None:
        notes.append(unit.note)
    if (
        dataset.dtypes[band - 1] == "uint8"
        and not picture
        and scaling.scale_m is None
        and dataset.scales[band - 1] == 1
    ):
        notes.append(
            f"{what} holds whole numbers from 0 to 255, as a picture does (a hillshade, a greyscale map): is it one of "
            "heights?"
        )
    nodata = dataset.nodatavals[band - 1]
    if nodata is None and dataset.driver == "AAIGrid":
        nodata = -9999.0  # the format's own default
    crs = None
    if north_up:
        crs = _check_grid(dataset, own, what, nodata is not None)
    if dataset.driver == "GTiff":
        _check_blocks(dataset, band)
    return Raster(
        source=source,
        drivers=(dataset.driver,),
        what=what,
        part=part,
        band=band,
        shape=(rows, cols),
        transform=dataset.transform,
        own_crs=own,
        crs=crs,
        dtype=dataset.dtypes[band - 1],
        nodata=nodata,
        factor=unit.factor,
        unit_said=unit.said,
        colours=colours,
        notes=tuple(notes),
    )


def _check_grid(dataset: DatasetReader, own: str | None, what: str, nodata_declared: bool) -> str | None:
    """Refuse a grid that is not north-up and square in true metres; return the name of its CRS."""
    transform, crs = dataset.transform, None
    if own:
        placed = transform.is_rectilinear and not transform.is_identity
        crs = crs_name(own, tuple(dataset.bounds) if placed else None, nodata_declared=nodata_declared)
    if transform.is_identity:
        return crs
    if transform.b or transform.d:
        target = crs if crs is not None and crs.startswith("EPSG:") else "CRS"
        options = f"--dst-crs {target} --res {math.hypot(transform.a, transform.d):g}"
        raise HeightmapError(
            f"{what} is rotated (transform terms {transform.b:g}, {transform.d:g}): give `reproject` as auto, "
            f"or turn it north-up with {warp_command(options, nodata_declared=nodata_declared)}",
            transform=list(transform)[:6],
        )
    if transform.a <= 0:
        raise HeightmapError(f"{what} is mirrored: its columns run west (pixel width {transform.a:g} m)")
    width, height = transform.a, abs(transform.e)
    if abs(width - height) > SAME_LENGTH * max(width, height):
        command = warp_command(f"--res {max(width, height):g}", nodata_declared=nodata_declared)
        raise HeightmapError(
            f"cells must be square, but those of {what} are {width:g} x {height:g} m: give `reproject` as auto, or "
            f"resample it with {command}",
            width_m=width,
            height_m=height,
        )
    return crs


def _checked_band(dataset: DatasetReader, band: int | None, what: str) -> int:
    """The number of the band with the heights. Raises HeightmapError if that is not known, or holds no heights."""
    kinds = dataset.colorinterp
    if band is None and dataset.count == 2 and kinds[1] == ColorInterp.alpha:
        band = 1
    if band is None:
        described = [k for k, words in enumerate(dataset.descriptions, 1) if (words or "").lower() in _VARIABLES]
        band = described[0] if len(described) == 1 else None
    if dataset.count != 1 and band is None:
        raise HeightmapError(
            f"{what} has {dataset.count} bands: give `band`, the number of the one with the heights "
            f"(1 to {dataset.count})",
            bands=dataset.count,
        )
    band = 1 if band is None else band
    if not 1 <= band <= dataset.count:
        raise HeightmapError(
            f"{what} has bands 1 to {dataset.count}, not {band}: give another `band`", bands=dataset.count
        )
    name = dataset.dtypes[band - 1]
    kind = "c" if "complex" in name else np.dtype(name).kind
    whose = what if dataset.count == 1 else f"`band` {band} of {what}"
    if kind not in "fiu":
        raise HeightmapError(f"{whose} holds {name}, not real numbers")
    if kinds[band - 1] == ColorInterp.palette:
        raise HeightmapError(f"{whose} is a picture with a colour table, not heights")
    block_rows, block_cols = dataset.block_shapes[band - 1]
    cell_bytes = np.dtype(name).itemsize * dataset.count
    if block_rows * block_cols * cell_bytes > max(_MAX_BLOCK_BYTES, dataset.height * dataset.width * cell_bytes):
        raise HeightmapError(f"{what} declares blocks of {block_rows} x {block_cols} cells around a small map: corrupt")
    return band


def _check_blocks(dataset: DatasetReader, band: int) -> None:
    """Refuse a GeoTIFF with blocks that were never written, unless it declares a no-data value, which GDAL returns."""
    if dataset.nodatavals[band - 1] is not None:
        return
    block_rows, block_cols = dataset.block_shapes[band - 1]
    down, across = -(-dataset.height // block_rows), -(-dataset.width // block_cols)
    missing = sum(
        dataset.get_tag_item(f"BLOCK_OFFSET_{j}_{i}", "TIFF", bidx=band) is None
        for i in range(down)
        for j in range(across)
    )
    if missing:
        raise HeightmapError(
            f"{missing} of the GeoTIFF's {down * across} blocks were never written: the file is incomplete",
            missing=missing,
        )


def _check_names(path: Path, levels: int) -> None:
    """Refuse a VRT that names anything but files on this machine which are rasters themselves."""
    text = path.read_bytes()[: _MAX_VRT_BYTES + 1].decode("utf-8", "replace")
    if len(text) > _MAX_VRT_BYTES or levels == 0:
        raise HeightmapError(f"{path.name} is a VRT of more than {_MAX_VRT_BYTES:,} bytes, or of VRTs of VRTs")
    for match in _NAMES.finditer(text):
        name = html.unescape(match.group(1) or "")
        there = path.parent / name
        if match.group(2) or not name or not there.is_file():
            raise HeightmapError(
                f"the VRT {path.name} names {(name or match.group(2))[:200]!r}, which is no file on this machine"
            )
        with there.open("rb") as stream:
            head = stream.read(512)
        if (_marked(head) or ("",))[0] == "VRT":
            _check_names(there, levels - 1)
        elif head.lstrip()[:1] in (b"<", b"{", b"["):
            raise HeightmapError(f"the VRT {path.name} names {name[:200]!r}, which is no raster")
