"""Decoders of heightmaps without GDAL: NumPy's .npy and .npz, and ESRI ASCII grids."""

from __future__ import annotations

import io
import lzma
import math
import re
import struct
import tokenize
import zipfile
import zlib
from typing import IO

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells

_MAX_NPY_HEADER = 10_000  # bytes; numpy writes 128 for a plain array
_MAX_SCALAR_BYTES = 65_536  # a CRS in WKT is about 1,000
_NPZ_SCALARS = ("resolution_m", "west_m", "north_m", "crs")


def decode_npy(stream: IO[bytes], length: int, scaling: Scaling, max_cells: int) -> Decoded:
    """One 2-D real array. length : bytes in the stream. Raises HeightmapError, TooLargeError."""
    values = _read_array(stream, "the .npy file", max_cells, expected_length=length)
    return Decoded(scaling.to_metres(values))


def decode_npz(stream: IO[bytes], scaling: Scaling, max_cells: int) -> Decoded:
    """`heights` (rows, cols) and, optionally, `resolution_m`, `west_m`, `north_m`, `crs`.

    Only what the headers declare is decompressed, after the declared size was accepted: a bomb stays packed.
    """
    try:
        with zipfile.ZipFile(stream) as archive:
            members = {i.filename.removesuffix(".npy"): i for i in archive.infolist() if i.filename.endswith(".npy")}
            if "heights" not in members:
                raise HeightmapError(
                    f"the .npz file has no array `heights`; it has {', '.join(sorted(members)) or 'none'}",
                    found=sorted(members)[:20],
                )
            with archive.open(members["heights"]) as member:
                values = _read_array(
                    member, "`heights` of the .npz file", max_cells, expected_length=members["heights"].file_size
                )
            scalars = {}
            for key in _NPZ_SCALARS:
                if key in members:
                    with archive.open(members[key]) as member:
                        scalars[key] = _read_scalar(member, key)
    except (
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
        struct.error,
        EOFError,
        OSError,
        NotImplementedError,
        RuntimeError,
        KeyError,
        ValueError,
    ) as error:
        raise HeightmapError(f"the .npz file is truncated or corrupt: {error}") from error
    return Decoded(
        scaling.to_metres(values),
        west_m=_number(scalars, "west_m"),
        north_m=_number(scalars, "north_m"),
        resolution_m=_number(scalars, "resolution_m"),
        crs=str(scalars["crs"]) if "crs" in scalars and scalars["crs"] not in ("", "None") else None,
    )


def _number(scalars: dict[str, object], key: str) -> float | None:
    if key not in scalars:
        return None
    value = scalars[key]
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise HeightmapError(f"`{key}` of the .npz file must be a finite number of metres, got {value!r}")
    return float(value)


def _read_header(stream: IO[bytes], what: str) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """(shape, fortran order, dtype, bytes read) of a .npy header, reading no more than _MAX_NPY_HEADER bytes."""
    magic = stream.read(8)
    if len(magic) < 8 or magic[:6] != b"\x93NUMPY":
        raise HeightmapError(f"{what} is not a NumPy array")
    if tuple(magic[6:8]) not in ((1, 0), (2, 0)):
        raise HeightmapError(f"{what} has .npy version {magic[6]}.{magic[7]}; 1.0 and 2.0 are read")
    width = 2 if magic[6] == 1 else 4
    size_bytes = stream.read(width)
    size = int.from_bytes(size_bytes, "little")
    if len(size_bytes) < width or size > _MAX_NPY_HEADER:
        raise HeightmapError(f"{what} has a header of {size} bytes; at most {_MAX_NPY_HEADER} make sense")
    header = stream.read(size)
    parse = npy_format.read_array_header_1_0 if magic[6] == 1 else npy_format.read_array_header_2_0
    try:
        shape, fortran, dtype = parse(io.BytesIO(size_bytes + header))
    except (ValueError, TypeError, SyntaxError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise HeightmapError(f"{what} is truncated or corrupt: its header cannot be read") from error
    return shape, fortran, dtype, 8 + width + size


def _read_array(stream: IO[bytes], what: str, max_cells: int, *, expected_length: int) -> NDArray:
    shape, fortran, dtype, read = _read_header(stream, what)
    if len(shape) != 2:
        raise HeightmapError(f"{what} must be a 2-D array (rows, cols), got shape {shape}", shape=list(shape))
    if dtype.kind not in "fiu":
        raise HeightmapError(f"{what} must hold real numbers, got {dtype.name}", dtype=str(dtype))
    check_cells(shape[0], shape[1], max_cells, what=what)
    size = shape[0] * shape[1] * dtype.itemsize
    if expected_length - read < size:
        raise HeightmapError(
            f"{what} is truncated: {shape[0]} x {shape[1]} cells need {size} bytes, "
            f"{max(expected_length - read, 0)} are there"
        )
    data = stream.read(size)
    if len(data) < size:
        raise HeightmapError(f"{what} is truncated: {size} bytes declared, {len(data)} there")
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")


def _read_scalar(stream: IO[bytes], key: str) -> object:
    what = f"`{key}` of the .npz file"
    shape, _, dtype, _ = _read_header(stream, what)
    if math.prod(shape) != 1 or dtype.kind not in "fiuUS" or dtype.itemsize > _MAX_SCALAR_BYTES:
        raise HeightmapError(f"{what} must be a single number or text, got shape {shape} of {dtype.name}")
    data = stream.read(dtype.itemsize)
    if len(data) < dtype.itemsize:
        raise HeightmapError(f"{what} is truncated")
    value = np.frombuffer(data, dtype=dtype)[0].item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


_ASC_KEYS = {
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
_ASC_LINE = re.compile(rb"\s*([A-Za-z_]+)[ \t]+([^\s]+)[ \t]*(?:\r\n|\r|\n|$)")


def decode_ascii(text: bytes, scaling: Scaling, max_cells: int) -> Decoded:
    """An ESRI ASCII grid, registered by corner or by centre.

    Parsed here and not by GDAL, whose reader takes words among the heights for 0 and drops the position when corner
    and centre are mixed. Raises HeightmapError, TooLargeError.
    """
    header: dict[str, float] = {}
    at = 3 if text.startswith(b"\xef\xbb\xbf") else 0
    while match := _ASC_LINE.match(text, at):
        key = match.group(1).decode("ascii").lower()
        if key not in _ASC_KEYS:
            break
        try:
            header[key] = float(match.group(2))
        except ValueError as error:
            raise HeightmapError(f"the ASCII grid's {key} is {match.group(2)[:40]!r}, not a number") from error
        at = match.end()
    rows, cols = (_asc_count(header, key) for key in ("nrows", "ncols"))
    check_cells(rows, cols, max_cells, what="the ASCII grid")
    dx, dy = header.get("cellsize", header.get("dx")), header.get("cellsize", header.get("dy"))
    for name, value in header.items():
        if not math.isfinite(value) and name != "nodata_value":
            raise HeightmapError(f"the ASCII grid's {name} is {value}, not a finite number")
    if dx is not None and dy is not None and abs(dx - dy) > 1e-3 * max(abs(dx), abs(dy)):
        raise HeightmapError(f"cells must be square, but the ASCII grid's are {dx:g} x {dy:g} m", dx=dx, dy=dy)
    try:
        values = np.fromstring(text[at:].decode("ascii"), sep=" ")
    except (ValueError, UnicodeDecodeError) as error:
        raise HeightmapError("the ASCII grid is corrupt: something among its heights is not a number") from error
    if values.size != rows * cols:
        kind = "truncated or corrupt" if values.size < rows * cols else "corrupt"
        raise HeightmapError(
            f"the ASCII grid is {kind}: {rows} x {cols} = {rows * cols} heights declared, {values.size} there",
            declared=rows * cols,
            found=int(values.size),
        )
    nodata = header.get("nodata_value", -9999.0)  # the format's own default
    heights = scaling.to_metres(values, known=values != nodata).reshape(rows, cols)
    west, south = _asc_edge(header, "x", dx), _asc_edge(header, "y", dy)
    north = south + rows * dy if south is not None and dy is not None else None
    return Decoded(heights, west_m=west, north_m=north, resolution_m=dx)


def _asc_count(header: dict[str, float], key: str) -> int:
    value = header.get(key)
    if value is None or not math.isfinite(value) or value != int(value):
        raise HeightmapError(f"the ASCII grid's header gives no whole number of {key[1:]} ({key} = {value})")
    return int(value)


def _asc_edge(header: dict[str, float], axis: str, cell: float | None) -> float | None:
    if f"{axis}llcorner" in header:
        return header[f"{axis}llcorner"]
    if f"{axis}llcenter" in header and cell is not None:
        return header[f"{axis}llcenter"] - 0.5 * cell
    return None
