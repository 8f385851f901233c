"""Points as texts (XYZ), PCD or PLY. Those on a regular grid are its cells; others are averaged by cell."""

from __future__ import annotations

import re

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling, check_cells
from joulemap.model.terrain.point_grid import PointGrid

_NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_LINE = re.compile(
    rb"\s*" + rb"[ \t,;]+".join([_NUMBER] * 3) + rb"[ \t,;]*(?:[ \t,;]" + _NUMBER + rb"[ \t,;]*)*(?:[\r\n]|\Z)"
)
_COMMENTS = re.compile(rb"(?:\xef\xbb\xbf)?(?:\s*(?:#|//)[^\r\n]*[\r\n]+)*")
_SPACE = rb"\"?[ \t,;]+\"?"
_HEADER = re.compile(
    rb"\s*\"?(?:x|e|east|easting|lon|longitude)(?:\[m\])?"
    + _SPACE
    + rb"(?:y|n|north|northing|lat|latitude)(?:\[m\])?"
    + _SPACE
    + rb"(?:z|h|height|elevation|elev|alt|altitude)\b[^\r\n]*[\r\n]+",
    re.IGNORECASE,
)
_PART_BYTES = 1 << 22
_MARKS = bytes.maketrans(b",;\t", b"   ")
_COMMA_MARKS = bytes.maketrans(b",;\t", b".  ")
_DECIMAL_COMMAS = re.compile(rb"\s*-?\d+(?:,\d+)?[ \t;]+-?\d+(?:,\d+)?[ \t;]+-?\d+,\d+\s*[ \t;\r\n]")
_MOST_STEPS = 1e9  # of a grid, along a side
_TEXTS = (".xyz", ".txt", ".csv", ".asc", ".dat", ".pts")
_PCD_TYPES = {
    "F4": "<f4",
    "F8": "<f8",
    **{f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in "1248"},
}
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
_HEADER_BYTES = 65_536
_MOST_OF_A_POINT = (
    20  # place, colour, normal, and the dozen attributes of LAS; a line of more numbers is a row of heights
)


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of PCD and PLY files; of a text, by three numbers in a line or by the header x, y, z.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Of the file.

    Returns
    -------
    bool
        True for points.
    """
    if head.startswith((b"ply\n", b"ply\r")) or _is_pcd(head):
        return True
    match = _COMMENTS.match(head)
    text = head[match.end() if match else 0 :]
    return name.lower().endswith(_TEXTS) and bool(_HEADER.match(text) or _LINE.match(text))


def _is_pcd(head: bytes) -> bool:
    return head.startswith((b"# .PCD", b"VERSION .7", b"VERSION 0.7"))


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the points, and lay a grid over them.

    Parameters
    ----------
    source : SourceFile
        The points.
    scaling : Scaling
        How heights become metres; `cell_m` is the side of a cell of points that lie on no grid.
    max_cells : int
        Largest number of cells, and of points.
    band : int, optional
        Not used.

    Returns
    -------
    Decoded
        Heights and place; holes where there is no point.

    Raises
    ------
    HeightmapError
        If the file is broken, or a line is no point.
    TooLargeError
        If there are more than `max_cells` points, or cells.
    """
    if source.head.startswith(b"ply"):
        points = _ply(source, max_cells)
    else:
        points = _pcd(source, max_cells) if _is_pcd(source.head) else _points(source, max_cells)
    if points.shape[1] > _MOST_OF_A_POINT:
        check_cells(len(points), points.shape[1], max_cells, what=source.name)
        return Decoded(
            scaling.to_metres(points), notes=("its lines were read as rows of heights, the first in the north",)
        )
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 4:
        raise HeightmapError(f"{source.name} holds {len(points)} points: there is no ground in it", points=len(points))
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    side = _regular(x, y)
    if side is not None and (scaling.cell_m is None or abs(scaling.cell_m - side) <= SAME_LENGTH * side):
        west, north = float(x.min()) - side / 2, float(y.max()) + side / 2
        rows, cols = round((north - float(y.min())) / side + 0.5), round((float(x.max()) - west) / side + 0.5)
        check_cells(rows, cols, max_cells, what=source.name)
        heights = np.full((rows, cols), np.nan)
        heights[np.floor((north - y) / side).astype(int), np.floor((x - west) / side).astype(int)] = z
        known = ~np.isnan(heights)
        return Decoded(scaling.to_metres(heights, known=known), west_m=west, north_m=north, resolution_m=side)
    bounds = (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
    grid = PointGrid(bounds, len(points), cell_m=scaling.cell_m, max_cells=max_cells, what=source.name)
    grid.add(x, y, z)
    heights = grid.heights()
    return Decoded(
        scaling.to_metres(heights, known=~np.isnan(heights)),
        west_m=grid.west_m,
        north_m=grid.north_m,
        resolution_m=grid.cell_m,
    )


def _points(source: SourceFile, most: int) -> NDArray[np.float64]:
    parts, found, lines = list[NDArray[np.float64]](), 0, 0
    with source.open() as stream:
        text = stream.read(_PART_BYTES)
        comments = _COMMENTS.match(text)
        text = text[comments.end() if comments else 0 :]
        header = _HEADER.match(text)
        rest, text = b"", text[header.end() if header else 0 :]
        columns: int | None = None
        while text or rest:
            whole = rest + text
            more = stream.read(_PART_BYTES)
            end = max(whole.rfind(b"\n"), whole.rfind(b"\r")) + 1 if more else len(whole)
            marks = _COMMA_MARKS if _DECIMAL_COMMAS.match(whole) else _MARKS
            part, rest, text = whole[:end].translate(marks), whole[end:], more
            if len(rest) > _PART_BYTES:
                raise HeightmapError(f"{source.name} is corrupt: a line of more than {_PART_BYTES:,} bytes")
            rows = [line for line in part.splitlines() if line.strip()]
            if rows:
                columns = len(rows[0].split()) if columns is None else columns
                parts.append(_parsed(rows, columns, lines, source.name))
                found += len(rows)
                lines += part.count(b"\n")
            _check_points(found, most, source.name)
    wide = columns if columns is not None and columns > _MOST_OF_A_POINT else 3
    return np.concatenate([np.empty((0, wide)), *(part[:, :wide] for part in parts)])


def _check_points(many: int, most: int, name: str) -> None:
    if many > most:
        raise TooLargeError(f"{name} holds {many:,} points; the limit is {most:,}", points=many, limit=most)


def _pcd(source: SourceFile, most: int) -> NDArray[np.float64]:
    """The points of a PCD file, (n, 3)."""
    with source.open() as stream:
        content = stream.read()
    header, fields = dict[str, list[str]](), list[tuple[str, str, tuple[int, ...]]]()
    at = 0
    while "DATA" not in header:
        end = content.find(b"\n", at, at + _HEADER_BYTES)
        if end < 0 or end > _HEADER_BYTES:
            raise HeightmapError(f"{source.name} is truncated or corrupt: the header of its points has no end")
        key, *words = content[at:end].decode("ascii", "replace").split() or ["#"]
        header[key], at = words, end + 1
    try:
        counts = header.get("COUNT") or ["1"] * len(header["FIELDS"])
        for k, (name, kind, size, count) in enumerate(
            zip(header["FIELDS"], header["TYPE"], header["SIZE"], counts, strict=True)
        ):
            fields.append((name if name in "xyz" else f"_{k}", _PCD_TYPES[kind + size], (int(count),)))
        many = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        how = header["DATA"][0]
        record = np.dtype([(name, kind) if shape == (1,) else (name, kind, shape) for name, kind, shape in fields])
        axes = [record.names.index(axis) for axis in "xyz"]  # type: ignore[union-attr]
    except (KeyError, ValueError, IndexError) as error:
        raise HeightmapError(f"{source.name} is corrupt: the header of its points has no {error}") from error
    _check_points(many, most, source.name)
    if how == "ascii":
        widths = np.cumsum([0, *(shape[0] for _, _, shape in fields)])
        return _table(content[at:], many, int(widths[-1]), source.name)[:, widths[axes]]
    body = memoryview(content)[at:]
    if how == "binary_compressed":
        long, full = (int(each) for each in np.frombuffer(body[:8], "<u4")) if len(body) >= 8 else (0, 0)
        if full != many * record.itemsize or long > len(body) - 8:
            raise HeightmapError(
                f"{source.name} is truncated or corrupt: {many:,} points declared, {full:,} bytes packed"
            )
        plain, length = lzf(np.frombuffer(body[8 : 8 + long], np.uint8), full)
        if length != full:
            raise HeightmapError(f"{source.name} is truncated or corrupt: {length:,} of {full:,} bytes can be unpacked")
        sizes = np.cumsum([0, *(many * record[k].itemsize for k in range(len(fields)))])
        return np.column_stack(
            [plain[sizes[k] : sizes[k] + many * record[k].itemsize].view(record[k]) for k in axes]
        ).astype(np.float64)
    return _records(body, record, many, source.name)


def _ply(source: SourceFile, most: int) -> NDArray[np.float64]:
    """The vertices of a PLY file, (n, 3)."""
    with source.open() as stream:
        content = stream.read()
    end = content.find(b"end_header", 0, _HEADER_BYTES)
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
    _check_points(many, most, source.name)
    if not order:
        return _table(content[at:], many, len(kinds), source.name)[:, axes]
    return _records(memoryview(content)[at:], record, many, source.name)


def _table(text: bytes, many: int, columns: int, name: str) -> NDArray[np.float64]:
    rows = text.split(b"\n", many)[:many]
    if len(rows) < many:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {len(rows):,} there")
    return _parsed(rows, columns, 0, name) if many else np.empty((0, columns))


def _records(body: memoryview, record: np.dtype, many: int, name: str) -> NDArray[np.float64]:
    there = len(body) // record.itemsize
    if not 0 <= many <= there:
        raise HeightmapError(f"{name} is truncated: {many:,} points declared, {there:,} there")
    points = np.frombuffer(body, record, many)
    return np.column_stack([points[axis].astype(np.float64) for axis in "xyz"])


@njit(cache=True)
def lzf(packed: NDArray[np.uint8], size: int) -> tuple[NDArray[np.uint8], int]:
    """Unpack the LZF compression of PCD files.

    Parameters
    ----------
    packed : ndarray of uint8
        The bytes.
    size : int
        Length of what is unpacked.

    Returns
    -------
    tuple of (ndarray of uint8, int)
        The content, and how much of it could be unpacked.
    """
    out = np.zeros(size, np.uint8)
    i, o = 0, 0
    while i < packed.size:
        control = int(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > packed.size or o + length > size:
                return out, o
            out[o : o + length] = packed[i : i + length]
            i, o = i + length, o + length
            continue
        length = control >> 5
        if length == 7:
            if i >= packed.size:
                return out, o
            length += int(packed[i])
            i += 1
        if i >= packed.size:
            return out, o
        back = o - ((control & 31) << 8) - int(packed[i]) - 1
        i, length = i + 1, length + 2
        if back < 0 or o + length > size:
            return out, o
        for k in range(length):
            out[o + k] = out[back + k]
        o += length
    return out, o


def _parsed(rows: list[bytes], columns: int, before: int, name: str) -> NDArray[np.float64]:
    if columns < 3:
        raise HeightmapError(f"{name}: its lines hold {columns} numbers, and not x, y and a height")
    text = b"\n".join(rows)
    codes = np.frombuffer(text, np.uint8)
    starts = np.diff(codes > 32, prepend=False) & (codes > 32)
    words = np.diff(np.cumsum(starts)[np.append(np.flatnonzero(codes == 10), codes.size - 1)], prepend=0)
    if (words == columns).all():
        try:
            return np.fromstring(text, sep=" ").reshape(-1, columns)
        except ValueError:  # the line is named below
            pass
    for k, line in enumerate(rows):
        try:
            ok = len([float(word) for word in line.split()]) == columns
        except ValueError:
            ok = False
        if not ok:
            shown = line[:60].decode("ascii", "replace")
            raise HeightmapError(f"{name}, line {before + k + 1}: {shown!r} is no point of {columns} numbers")
    return np.array([line.split() for line in rows], dtype=np.float64)


def _regular(x: NDArray[np.float64], y: NDArray[np.float64]) -> float | None:
    """The side of the cells whose centres the points are; None where they are on no square grid."""
    sides = []
    for values in (x, y):
        steps = np.diff(np.unique(values))
        steps = steps[steps > 1e-6]
        if not steps.size:
            return None
        side = float(steps.min())
        if float(values.max()) - float(values.min()) >= _MOST_STEPS * side:
            return None
        if np.abs(steps / side - np.round(steps / side)).max() > 1e-3:
            return None
        sides.append(side)
    return sides[0] if abs(sides[0] - sides[1]) <= SAME_LENGTH * sides[0] else None
