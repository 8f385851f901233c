"""Rasters that GDAL reads: one band as heights, or a picture whose colours are heights; whole or by windows."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from rasterio.io import DatasetReader

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.coordinate_systems import flat_crs
from joulemap.model.terrain.decoded import MAX_SIDE, Scaling, check_cells
from joulemap.model.terrain.formats import FORMATS, formats_in_words
from joulemap.model.terrain.formats.ascii_text import HEADER_WORDS, check_ascii_grid
from joulemap.model.terrain.formats.colours import GREY, colours_of
from joulemap.model.terrain.formats.gdal import ALONE, BESIDE, opened
from joulemap.model.terrain.formats.raster_band import Raster
from joulemap.model.terrain.formats.raster_checks import HEIGHTS, check_blocks, check_grid, checked_band, transform_of
from joulemap.model.terrain.formats.vrt import check_names, is_vrt
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
    b"north:": ("GRASSASCIIGrid", "GRASS ASCII grid"),
    **dict.fromkeys((word.encode() for word in HEADER_WORDS), ("AAIGrid", "ASCII grid")),
}
_PICTURES = ("PNG", "PNM", "JPEG", "BMP", "WEBP", "GIF")  # their numbers are counts
_OTHERS = {  # first bytes, or the suffix, of what holds ground and is not read -> what it is, and what makes it a map
    "ASTM-E57": "an E57 scan: save it as LAS or PLY",
    "# Octomap": "a map of OctoMap, cubes that are occupied: save its ground as points (PCD, PLY)",
    "MATLAB 5.0 MAT": "a MATLAB file: write its heights with `writematrix`, or as GeoTIFF",
    ".obj": "a mesh: sample points of it (CloudCompare), and save them as PLY",
    ".stl": "a mesh: sample points of it (CloudCompare), and save them as PLY",
    ".dae": "a mesh: sample points of it (CloudCompare), and save them as PLY",
    ".raw": "a file without a header: say its shape by `numpy.fromfile(...).reshape(...)`, and save it as .npy",
}
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PGM = re.compile(rb"P[25]" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,9})\s")
_WITH_HEADER = (".bil", ".bip", ".bsq", ".flt", ".sdat", ".dat", ".rst", ".gri")


def recognise(head: bytes, name: str) -> bool:
    """Take any file that no other format has taken: GDAL decides by all of its content."""
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

    `north_up`: whether it must lie on a north-up grid of square cells of true metres.
    """
    driver, what = _marked(source.head) or ("", "")
    if source.alone and (driver == "VRT" or source.head.startswith(b"\x89HDF")):
        raise HeightmapError(
            f"{source.name} is a {what}, which names other files or may do so; here one file is read and no other: "
            f"convert it where they lie (gdal_translate {source.name} map.tif), or use the command line there"
        )
    if driver == "VRT":
        assert isinstance(source.place, Path)
        check_names(source.place)
    if driver == "AAIGrid":
        source = check_ascii_grid(source, max_cells)
    if driver == "GRASSASCIIGrid":
        source = _without_stars(source)
    if driver == "PNM":
        source = _whole_pgm(source, max_cells)
    if what:
        drivers = ("netCDF", "HDF5", "BAG", "S102") if source.head.startswith(b"\x89HDF") else (driver,)
        return _opened(source, drivers, f"the {what}", scaling, band, max_cells, north_up)
    try:
        return _opened(source, ALONE if source.alone else BESIDE, source.name, scaling, band, max_cells, north_up)
    except HeightmapError as error:
        if "not recognized as being in a supported file format" not in error.message:
            raise
        suffix = Path(source.name).suffix.lower()
        for mark, other in _OTHERS.items():
            if suffix == mark or source.head.startswith(mark.encode()):
                raise HeightmapError(f"{source.name} is {other}", name=source.name) from error
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


def _marked(head: bytes) -> tuple[str, str] | None:
    """Driver and name of a format that has a mark of its own."""
    if is_vrt(head):
        return "VRT", "VRT"
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for mark, found in _MARKS.items():
        if head.startswith(mark) or (mark.islower() and text.startswith(mark)):
            return found
    return None


def _without_stars(source: SourceFile) -> SourceFile:
    """A GRASS ASCII grid whose unknown cells are a number: GDAL takes the usual `*` for 0."""
    with source.open() as stream:
        content = stream.read()
    if b"*" not in content:
        return source
    first, end, rest = content.partition(b"\n")
    return replace(source, place=first + end + b"null: -99999\n" + rest.replace(b"*", b"-99999"))


def _whole_pgm(source: SourceFile, max_cells: int) -> SourceFile:
    """A PGM that holds as many cells as it declares, of bytes, which alone GDAL reads."""
    with source.open() as stream:
        content = stream.read()
    header = _PGM.match(content)
    cols, rows, largest = (int(word) for word in header.groups()) if header else (0, 0, 0)
    check_cells(rows, cols, max_cells, what="the PGM image")
    body = content[header.end() :] if header else b""
    try:
        written = np.array(body.split(), dtype=">u2") if content.startswith(b"P2") else None
    except (ValueError, OverflowError):
        written = np.empty(0)
    there = len(body) // (2 if largest > 255 else 1) if written is None else written.size
    if there < rows * cols or not 0 < largest < 65_536:
        raise HeightmapError(
            f"the PGM image is truncated or corrupt: {rows} x {cols} cells declared, {there:,} there",
            declared=rows * cols,
            found=there,
        )
    if written is None:
        return source
    return replace(source, place=b"P5\n%d %d\n65535\n" % (cols, rows) + written[: rows * cols].tobytes())


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
    named = [part for part in parts if part.rpartition("/")[2].lower() in HEIGHTS]
    if band is None and len(named) != 1:
        raise HeightmapError(
            f"{what} has several variables: give `band`, the number of the one with the heights, of "
            f"{', '.join(f'{k} {part}' for k, part in enumerate(parts, 1))[:300]}",
            bands=len(parts),
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
    band = 1 if colours is not None else checked_band(dataset, band, what)
    if picture and colours is None and scaling.scale_m is None:
        raise HeightmapError(
            f"{what} is a picture: it holds counts, not metres: give `scale_m`, the metres per count (and `offset_m`, "
            "the height of count 0)"
        )
    whole_crs = dataset.crs.to_wkt() if dataset.crs else None
    if whole_crs is None and {"degrees_north", "degrees_east"} <= {*dataset.tags().values()}:
        whole_crs = "EPSG:4326"  # the units of the CF conventions
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
    crs, transform = None, transform_of(dataset)
    if north_up:
        crs = check_grid(transform, (rows, cols), own, what, nodata is not None)
    if dataset.driver == "GTiff":
        check_blocks(dataset, band)
    return Raster(
        source=source,
        drivers=(dataset.driver,),
        what=what,
        part=part,
        band=band,
        shape=(rows, cols),
        transform=transform,
        own_crs=own,
        crs=crs,
        dtype=dataset.dtypes[band - 1],
        nodata=nodata,
        factor=unit.factor,
        unit_said=unit.said,
        colours=colours,
        notes=tuple(notes),
    )
