"""Greyscale PNG: counts of 8 or 16 bits, which a scale turns into metres."""

from __future__ import annotations

import struct

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells
from joulemap.model.terrain.formats.gdal import opened, read_band

_KINDS = {
    0: "greyscale",
    2: "colour",
    3: "palette",
    4: "greyscale with transparency",
    6: "colour with transparency",
}


def recognise(head: bytes, name: str) -> bool:
    """Decide by the signature of PNG files.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for a PNG file.
    """
    return head.startswith(b"\x89PNG\r\n\x1a\n")


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read a greyscale PNG of 8 or 16 bits.

    Parameters
    ----------
    source : SourceFile
        The image.
    scaling : Scaling
        height = count * scale_m + offset_m; a scale is required.
    max_cells : int
        Largest number of pixels.
    band : int, optional
        Not used: the image has one channel.

    Returns
    -------
    Decoded
        Heights without a place: a PNG holds none.

    Raises
    ------
    HeightmapError
        Without a scale, or where the image is in colour or broken.
    TooLargeError
        If the header declares more than `max_cells` pixels.
    """
    head = source.head
    if len(head) < 26 or head[12:16] != b"IHDR":
        raise HeightmapError("the PNG image is truncated or corrupt: it has no header")
    cols, rows, bits, colour = struct.unpack(">IIBB", head[16:26])
    check_cells(rows, cols, max_cells, what="the PNG image")
    if colour != 0 or bits not in (8, 16):
        raise HeightmapError(
            f"a PNG heightmap is greyscale with 8 or 16 bits; this one is {_KINDS.get(colour, 'unknown')} "
            f"with {bits} bits"
        )
    if scaling.scale_m is None:
        raise HeightmapError(
            "a PNG image holds counts, not metres: give `scale_m`, the metres per count (and `offset_m`, the height of "
            "count 0)"
        )
    with opened(source.place, "PNG") as dataset:
        heights = read_band(dataset, 1, scaling, slice(0, dataset.height), slice(0, dataset.width))
    return Decoded(heights)
