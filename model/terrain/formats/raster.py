"""Rasters that GDAL reads: one band as heights, or a picture whose colours are heights; whole or by windows."""

from __future__ import annotations

from pathlib import Path

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
from joulemap.model.terrain.formats.raster_checks import HEIGHTS, check_blocks, check_grid, checked_band
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
_WITH_HEADER = (".bil", ".bip", ".bsq", ".flt", ".sdat", ".dat", ".rst", ".gri", ".raw")


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


def _marked(head: bytes) -> tuple[str, str] | None:
    """Driver and name of a format that has a mark of its own."""
    if is_vrt(head):
        return "VRT", "VRT"
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for mark, found in _MARKS.items():
        if head.startswith(mark) or (mark.islower() and text.startswith(mark)):
            return found
    return None


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
        crs = check_grid(dataset, own, what, nodata is not None)
    if dataset.driver == "GTiff":
        check_blocks(dataset, band)
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
