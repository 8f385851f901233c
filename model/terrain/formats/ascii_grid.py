"""ESRI ASCII grids: a header of six lines, then the heights as text.

Parsed here and not by GDAL, whose reader takes words among the heights for 0 and drops the position when corner and
centre are mixed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling, check_cells

_KEYS = {
    "ncols",
    "nrows",
    "xllcorner",
    "yllcorner",
    "xllcenter",
    "yllcenter",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
}
_LINE = re.compile(rb"\s*([A-Za-z_]+)[ \t]+([^\s]+)[ \t]*(?:\r\n|\r|\n|$)")
_FIRST_WORDS = tuple(sorted(key.encode() for key in _KEYS - {"dy"}))
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_HEADER_BYTES = 16_384  # ten lines of a header are about 300
_PART_BYTES = 1 << 22  # of text that are parsed at a time
_MOST_DIGITS = 1_000  # of one number; a longer word is none


def recognise(head: bytes, name: str) -> bool:
    """Decide by the first word, which is one of the header's.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for an ESRI ASCII grid.
    """
    return head.removeprefix(_BYTE_ORDER_MARK).lstrip().lower().startswith(_FIRST_WORDS)


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read a grid, registered by corner or by centre.

    Parameters
    ----------
    source : SourceFile
        The grid.
    scaling : Scaling
        How values become metres.
    max_cells : int
        Largest number of cells.
    band : int, optional
        Not used.

    Returns
    -------
    Decoded
        Heights, and the place that the header states.

    Raises
    ------
    HeightmapError
        If the header or a height is missing or is no number, or cells are not square.
    TooLargeError
        If the header declares more than `max_cells` cells.
    """
    with source.open() as stream:
        text = stream.read(_HEADER_BYTES)
    header: dict[str, float] = {}
    at = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
    while match := _LINE.match(text, at):
        key = match.group(1).decode("ascii").lower()
        if key not in _KEYS:
            break
        try:
            header[key] = float(match.group(2))
        except ValueError as error:
            word = match.group(2)[:40].decode("ascii", "replace")
            comma = "; decimals need a point" if "," in word else ""
            raise HeightmapError(f"the ASCII grid's {key} is {word!r}, not a number{comma}") from error
        at = match.end()
    rows, cols = (_count(header, key) for key in ("nrows", "ncols"))
    check_cells(rows, cols, max_cells, what="the ASCII grid")
    dx, dy = header.get("cellsize", header.get("dx")), header.get("cellsize", header.get("dy"))
    for name, value in header.items():
        if not math.isfinite(value) and name != "nodata_value":
            raise HeightmapError(f"the ASCII grid's {name} is {value}, not a finite number")
    if dx is not None and dy is not None and abs(dx - dy) > SAME_LENGTH * max(abs(dx), abs(dy)):
        raise HeightmapError(f"cells must be square, but the ASCII grid's are {dx:g} x {dy:g} m", dx=dx, dy=dy)
    nodata = header.get("nodata_value", -9999.0)  # the format's own default
    heights, found = np.empty(rows * cols, dtype=np.float32), 0
    with source.open() as stream:
        stream.seek(at)
        for values in _numbers(stream):
            if found + values.size <= heights.size:
                heights[found : found + values.size] = scaling.to_metres(values, known=values != nodata)
            found += values.size
    if found != rows * cols:
        kind = "truncated or corrupt" if found < rows * cols else "corrupt"
        raise HeightmapError(
            f"the ASCII grid is {kind}: {rows} x {cols} = {rows * cols} heights declared, {found} there",
            declared=rows * cols,
            found=found,
        )
    west, south = _edge(header, "x", dx), _edge(header, "y", dy)
    north = south + rows * dy if south is not None and dy is not None else None
    return Decoded(heights.reshape(rows, cols), west_m=west, north_m=north, resolution_m=dx)


def _numbers(stream: BinaryIO) -> Iterator[NDArray[np.float64]]:
    """The numbers of a text, part by part. Raises HeightmapError if a word is none."""
    rest = b""
    while text := stream.read(_PART_BYTES):
        text = rest + text
        end = max(text.rfind(space) for space in (b" ", b"\n", b"\r", b"\t")) + 1
        text, rest = text[:end], text[end:]
        if len(rest) > _MOST_DIGITS:
            raise HeightmapError(
                f"the ASCII grid is corrupt: a word of more than {_MOST_DIGITS} letters in its heights"
            )
        yield _parsed(text)
    yield _parsed(rest)


def _parsed(text: bytes) -> NDArray[np.float64]:
    if not text.strip():  # of which NumPy makes the number -1
        return np.empty(0)
    try:
        return np.fromstring(text.decode("ascii"), sep=" ")
    except (ValueError, UnicodeDecodeError) as error:
        raise HeightmapError("the ASCII grid is corrupt: something among its heights is not a number") from error


def _count(header: dict[str, float], key: str) -> int:
    value = header.get(key)
    if value is None or not math.isfinite(value) or value != int(value):
        raise HeightmapError(f"the ASCII grid's header gives no whole number of {key[1:]} ({key} = {value})")
    return int(value)


def _edge(header: dict[str, float], axis: str, cell: float | None) -> float | None:
    if f"{axis}llcorner" in header:
        return header[f"{axis}llcorner"]
    if f"{axis}llcenter" in header and cell is not None:
        return header[f"{axis}llcenter"] - 0.5 * cell
    return None
