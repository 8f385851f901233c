"""Points in PLY files: the vertices, as text or binary."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.formats.point_lines import HEADER_BYTES, check_points, records, table

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply_points(source: SourceFile, most: int) -> NDArray[np.float64]:
    """Read the vertices of a PLY file. The result is (n, 3)."""
    with source.open() as stream:
        content = stream.read()
    end = content.find(b"end_header", 0, HEADER_BYTES)
    at = content.find(b"\n", end) + 1
    if end < 0 or at == 0:
        raise HeightmapError(f"{source.name} is truncated or corrupt: the header of its points has no end")
    lines = [line.split() for line in content[:end].decode("ascii", "replace").splitlines()[1:] if line.strip()]
    try:
        order = next(_PLY_ORDERS[line[1]] for line in lines if line[0] == "format")
        elements = [(k, line[1], int(line[2])) for k, line in enumerate(lines) if line[0] == "element"]
        (start, name, many) = elements[0]
        last = elements[1][0] if len(elements) > 1 else len(lines)
        kinds = [(line[2], order + _PLY_TYPES[line[1]]) for line in lines[start + 1 : last] if line[0] == "property"]
        record = np.dtype(kinds)
        axes = [record.names.index(axis) for axis in "xyz"]  # type: ignore[union-attr]
    except (KeyError, ValueError, IndexError, StopIteration, AttributeError) as error:
        raise HeightmapError(
            f"{source.name} is corrupt: its header names no vertices of x, y and z ({error})"
        ) from error
    if name != "vertex":
        raise HeightmapError(f"{source.name} begins with elements of {name[:40]!r}, and not with its vertices")
    check_points(many, most, source.name)
    if not order:
        return table(content[at:], many, len(kinds), source.name)[:, axes]
    return records(memoryview(content)[at:], record, many, source.name)
