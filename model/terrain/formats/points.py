"""Points as texts (XYZ), PCD or PLY. Those on a regular grid are its cells; others are averaged by cell."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling, check_cells
from joulemap.model.terrain.formats.pcd import is_pcd, pcd_points
from joulemap.model.terrain.formats.ply import ply_points
from joulemap.model.terrain.formats.point_lines import check_points, parsed
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
_MOST_OF_A_POINT = 20  # place, colour, normal, and the attributes of LAS; more numbers are a row of heights


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of PCD and PLY files; of a text, by three numbers in a line or by the header x, y, z."""
    if head.startswith((b"ply\n", b"ply\r")) or is_pcd(head):
        return True
    match = _COMMENTS.match(head)
    text = head[match.end() if match else 0 :]
    return name.lower().endswith(_TEXTS) and bool(_HEADER.match(text) or _LINE.match(text))


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the points, and lay a grid over them."""
    if source.head.startswith(b"ply"):
        points = ply_points(source, max_cells)
    else:
        points = pcd_points(source, max_cells) if is_pcd(source.head) else _points(source, max_cells)
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
                parts.append(parsed(rows, columns, lines, source.name))
                found += len(rows)
                lines += part.count(b"\n")
            check_points(found, most, source.name)
    wide = columns if columns is not None and columns > _MOST_OF_A_POINT else 3
    return np.concatenate([np.empty((0, wide)), *(part[:, :wide] for part in parts)])


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
