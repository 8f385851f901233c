"""NumPy arrays: one 2-D array of heights in a .npy file, which has no place of its own."""

from __future__ import annotations

import io
import tokenize
from typing import IO

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells
from joulemap.model.terrain.formats.point_lines import check_points
from joulemap.model.terrain.formats.points import gridded

_MAX_NPY_HEADER = 10_000  # bytes; numpy writes 128 for a plain array
_PART_BYTES = 1 << 24  # read at a time


def recognise(head: bytes, name: str) -> bool:
    """Decide by the signature of .npy files."""
    return head.startswith(b"\x93NUMPY")


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read one 2-D array of real numbers: heights, or x, y and height of points, which are three columns."""
    with source.open() as stream:
        shape, _, dtype, _ = read_header(stream, "the .npy file")
        if len(shape) == 2 and shape[0] > shape[1] == 3 and dtype.kind == "f":
            check_points(shape[0], max_cells, source.name)
            stream.seek(0)
            return gridded(_whole(stream, source), scaling, max_cells, source.name)
        stream.seek(0)
        heights = read_heights(stream, "the .npy file", scaling, max_cells, expected_length=source.size_bytes)
    return Decoded(heights)


def _whole(stream: IO[bytes], source: SourceFile) -> NDArray[np.float64]:
    try:
        return np.asarray(npy_format.read_array(stream, allow_pickle=False), dtype=np.float64)
    except ValueError as error:
        raise HeightmapError(f"{source.name} is truncated: {str(error)[:200]}") from error


def read_header(stream: IO[bytes], what: str) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Read the header of a .npy stream, of limited size.

    Result: shape, whether the order is Fortran's, dtype, and the number of bytes read.
    """
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


def read_heights(
    stream: IO[bytes], what: str, scaling: Scaling, max_cells: int, *, expected_length: int
) -> NDArray[np.float32]:
    """Read a 2-D real array part by part; nothing is allocated for one that is too large or not there.

    Result (rows, cols): heights [m], NaN where unknown.
    """
    shape, fortran, dtype, read = read_header(stream, what)
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
    heights = np.empty(shape, dtype=np.float32)
    lines = heights.T if fortran else heights  # in the order of the file
    count, length = lines.shape
    step = max(1, _PART_BYTES // (length * dtype.itemsize))
    for start in range(0, count, step):
        wanted = min(step, count - start) * length * dtype.itemsize
        data = stream.read(wanted)
        if len(data) < wanted:
            found = start * length * dtype.itemsize + len(data)
            raise HeightmapError(f"{what} is truncated: {size} bytes declared, {found} there")
        lines[start : start + step] = scaling.to_metres(np.frombuffer(data, dtype=dtype).reshape(-1, length))
    return heights
