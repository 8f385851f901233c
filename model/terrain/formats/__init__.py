"""The heightmap formats: one line in `FORMATS` for each, and a module that recognises and decodes its files."""

from __future__ import annotations

from joulemap.model.terrain.formats.contract import HeightmapFormat

FORMATS = [
    HeightmapFormat("GeoTIFF", (".tif", ".tiff"), ".geotiff"),
    HeightmapFormat("ESRI ASCII grid", (".asc",), ".ascii_grid"),
    HeightmapFormat("NumPy array", (".npy",), ".npy"),
    HeightmapFormat("NumPy archive", (".npz",), ".npz"),
    HeightmapFormat("greyscale PNG", (".png",), ".png"),
    HeightmapFormat("LAS point cloud", (".las", ".laz"), ".las"),
    HeightmapFormat("XYZ points", (".xyz",), ".xyz"),
    HeightmapFormat("grid map in MCAP or a ROS bag", (".mcap", ".bag", ".db3"), ".ros_grid_map"),
]
"""All formats that are read, in the order in which they are tried. A module name with a dot in front lies here."""


def formats_in_words() -> str:
    """Return the formats with their suffixes, as messages, the help and the API's description list them."""
    return ", ".join(f"{each.name} ({', '.join(each.suffixes)})" for each in FORMATS)
