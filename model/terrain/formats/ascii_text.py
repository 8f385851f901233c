"""What GDAL does not see in an ESRI ASCII grid: words among the heights, which it takes for 0, and too many heights."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import check_cells

_LINE = re.compile(rb"\s*([A-Za-z_]+)[ \t]+([^\s]+)[ \t]*(?:\r\n|\r|\n|$)")
_WORDS = "ncols nrows xllcorner yllcorner xllcenter yllcenter cellsize dx dy nodata_value"
HEADER_WORDS = tuple(_WORDS.split(" "))
"""What the lines of the header begin with."""

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_HEADER_BYTES = 16_384  # ten lines of a header are about 300
_PART_BYTES = 1 << 22
_OF_NUMBERS = np.isin(np.arange(256), list(b"0123456789+-.eE \t\r\nnNaAiIfF"))  # also nan and inf


def check_ascii_grid(source: SourceFile, max_cells: int) -> SourceFile:
    """Refuse a grid whose header or heights are no numbers, or too few, or too many.

    Result: the same, as GDAL reads it: without a byte order mark, registered in x and y alike.
    """
    with source.open() as stream:
        text = stream.read(_HEADER_BYTES)
        if b"," in text and b"." not in text:  # decimal commas
            source = replace(source, place=(text + stream.read()).replace(b",", b"."))
            text = text.replace(b",", b".")
    start = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
    header, at = dict[str, float](), start
    while match := _LINE.match(text, at):
        key, word = match.group(1).decode("ascii").lower(), match.group(2).decode("ascii", "replace")
        if key not in HEADER_WORDS:
            break
        try:
            header[key] = float(word)
        except ValueError as error:
            comma = "; decimals need a point" if "," in word else ""
            raise HeightmapError(f"the ASCII grid's {key} is {word[:40]!r}, not a number{comma}") from error
        if not math.isfinite(header[key]) and key != "nodata_value":
            raise HeightmapError(f"the ASCII grid's {key} is {word[:40]}, not a finite number")
        at = match.end()
    rows, cols = (_count(header, key) for key in ("nrows", "ncols"))
    check_cells(rows, cols, max_cells, what="the ASCII grid")
    if header.get("cellsize", header.get("dx", 1.0)) <= 0:
        raise HeightmapError("the ASCII grid's cellsize must be a positive number: the resolution of the map")
    found, inside = 0, False
    with source.open() as stream:
        stream.seek(at)
        while part := stream.read(_PART_BYTES):
            codes = np.frombuffer(part, np.uint8)
            if not _OF_NUMBERS[codes].all():
                raise HeightmapError("the ASCII grid is corrupt: something among its heights is not a number")
            black = codes > 32
            found += int(np.count_nonzero(black[1:] & ~black[:-1])) + int(black[0] and not inside)
            inside = bool(black[-1])
    if found != rows * cols:
        kind = "truncated or corrupt" if found < rows * cols else "corrupt"
        raise HeightmapError(
            f"the ASCII grid is {kind}: {rows} x {cols} = {rows * cols} heights declared, {found} there",
            declared=rows * cols,
            found=found,
        )
    mixed = next(
        (f"{axis}llcenter" for axis, other in ("xy", "yx") if {f"{axis}llcenter", f"{other}llcorner"} <= header.keys()),
        None,
    )
    if mixed is not None and "cellsize" in header:  # GDAL drops such a place
        edge = b"%cllcorner %r" % (mixed[0].encode(), header[mixed] - 0.5 * header["cellsize"])
        lines = re.sub(mixed.encode() + rb"[ \t]+\S+", edge, text[start:at], flags=re.IGNORECASE)
    elif start:
        lines = text[start:at]
    else:
        return source
    with source.open() as stream:
        stream.seek(at)
        return replace(source, place=lines + stream.read())


def _count(header: dict[str, float], key: str) -> int:
    value = header.get(key)
    if value is None or value != int(value):
        raise HeightmapError(f"the ASCII grid's header gives no whole number of {key[1:]} ({key} = {value})")
    return int(value)
