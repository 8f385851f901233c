"""The heightmap formats: one line in `FORMATS` for each, and a module that recognises and decodes its files."""

from __future__ import annotations

from joulemap.model.terrain.formats.contract import HeightmapFormat

_NAMED = 12  # suffixes that messages list of a format

_RASTERS = (
    "tif tiff asc png hgt dt0 dt1 dt2 img nc grd dem bil flt sdat dat bt vrt pgm pnm jp2 jpg jpeg webp bmp ers gxf adf "
    "rst mpr cub lbl pds h5 he5 bag ter hf2 gtx isg agr bip bsq fits"
)
RASTER_SUFFIXES = tuple(f".{each}" for each in _RASTERS.split(" "))
"""Usual endings of rasters that GDAL reads and that may be heights."""

FORMATS = [
    HeightmapFormat("NumPy array", (".npy",), ".npy"),
    HeightmapFormat("NumPy archive", (".npz",), ".npz"),
    HeightmapFormat("LAS point cloud", (".las", ".laz"), ".las"),
    HeightmapFormat("points as XYZ, PCD or PLY", (".xyz", ".pcd", ".ply"), ".points"),
    HeightmapFormat("grid map in MCAP or a ROS bag", (".mcap", ".bag", ".db3"), ".ros_grid_map"),
    HeightmapFormat("GeoTIFF and other rasters", RASTER_SUFFIXES, ".raster"),
]
"""All formats that are read, in the order in which they are tried. A module name with a dot in front lies here."""


def formats_in_words() -> str:
    """Return the formats with their suffixes, as messages, the help and the API's description list them."""
    return ", ".join(f"{each.name} ({', '.join(each.suffixes[:_NAMED])})" for each in FORMATS)
