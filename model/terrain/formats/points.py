"""Points as texts (XYZ), PCD or PLY. Those on a regular grid are its cells; others are averaged by cell."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from io import TextIOWrapper
from typing import IO, cast
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling, check_cells
from joulemap.model.terrain.formats.pcd import is_pcd, pcd_points
from joulemap.model.terrain.formats.ply import ply_points
from joulemap.model.terrain.formats.point_lines import check_points, parsed
from joulemap.model.terrain.point_grid import PointGrid

_WORDS = {
    "x": "x e east easting lon long longitude rechtswert ostwert est este coordx",
    "y": "y n north northing lat latitude hochwert nordwert nord norte coordy",
    "z": "z h height elevation elev alt altitude hoehe hohe hauteur altura altitud cota altezza quota altitudine",
}
_NAMES = {axis: frozenset(words.split()) for axis, words in _WORDS.items()}
_UNIT = re.compile(r"[\[(][^\])]*[\])]|[_ ](?:m|deg)$")
_PART_LINES = 1_000_000
_LONGEST_LINE = 1 << 22
_MOST_STEPS = 1e9  # of a grid, along a side
_ROUNDED = 0.1  # of a cell, by which a centre may be off its grid
_TEXTS = (".xyz", ".txt", ".csv", ".asc", ".dat", ".pts")
_MOST_OF_A_POINT = 20  # place, colour, normal, and the attributes of LAS; more numbers are a row of heights


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of PCD and PLY files; of a text, by three numbers in a line, also after a header."""
    if head.startswith((b"ply\n", b"ply\r")) or is_pcd(head):
        return True
    if not name.lower().endswith(_TEXTS):
        return False
    lines = [line for line in head.decode("utf-8-sig", "replace").splitlines() if _is_line(line)]
    return bool(lines) and (_shape(lines[0]) is not None or _is_header(*lines[:2]))


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
    return gridded(points, scaling, max_cells, source.name)


def gridded(points: NDArray[np.float64], scaling: Scaling, max_cells: int, name: str) -> Decoded:
    """Return points as cells: those of the grid on which they lie, or their means.

    `points` (n, 3): x, y and height.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 4:
        raise HeightmapError(f"{name} holds {len(points)} points: there is no ground in it", points=len(points))
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    side = _regular(x, y)
    if side is not None and (scaling.cell_m is None or abs(scaling.cell_m - side) <= SAME_LENGTH * side):
        west, north = float(x.min()) - side / 2, float(y.max()) + side / 2
        rows, cols = round((north - float(y.min())) / side + 0.5), round((float(x.max()) - west) / side + 0.5)
        check_cells(rows, cols, max_cells, what=name)
        heights = np.full((rows, cols), np.nan)
        heights[np.floor((north - y) / side).astype(int), np.floor((x - west) / side).astype(int)] = z
        known = ~np.isnan(heights)
        return Decoded(scaling.to_metres(heights, known=known), west_m=west, north_m=north, resolution_m=side)
    bounds = (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
    grid = PointGrid(bounds, len(points), cell_m=scaling.cell_m, max_cells=max_cells, what=name)
    grid.add(x, y, z)
    heights = grid.heights()
    return Decoded(
        scaling.to_metres(heights, known=~np.isnan(heights)),
        west_m=grid.west_m,
        north_m=grid.north_m,
        resolution_m=grid.cell_m,
    )


@dataclass(frozen=True)
class _Shape:
    """How the lines of a text are divided, by its first: the mark between cells, whether commas are decimal marks, the
    names of the columns, and which of them are x, y and z (all of a line of numbers).
    """

    mark: str | None
    commas: bool
    names: tuple[str, ...]
    used: tuple[int, ...] | None


def _is_line(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(("#", "//"))


def _shape(line: str) -> _Shape | None:
    """What a first line says; None where it is neither three numbers nor the names of x, y and z."""
    mark = next((each for each in ";\t" if each in line), None)
    commas = "," in line and (mark is not None or all(len(re.findall(",\\d", word)) == 1 for word in line.split()))
    mark = mark or ("," if "," in line and not commas else None)
    cells = tuple(cell.strip().strip('"') for cell in (line.replace(",", ".") if commas else line).split(mark))
    if len(cells) > 2 and all(map(_is_number, filter(None, cells))):
        return _Shape(mark, commas, (), None)
    ascii_only = (normalize("NFKD", cell.lower()).encode("ascii", "ignore").decode() for cell in cells)  # Höhe
    plain = [_UNIT.sub("", cell).strip() for cell in ascii_only]
    if len(cells) > _MOST_OF_A_POINT and all(map(_is_number, cells[1:])):
        return _Shape(mark, commas, cells, None)  # of a matrix: x above, y in front
    found = _columns(plain)
    return None if min(found) < 0 else _Shape(mark, mark != ",", cells, tuple(found))


def _is_header(line: str, below: str = "") -> bool:
    """Whether a line is of words, and the next of as many numbers."""
    shape = _shape(below)
    return shape is not None and not shape.names and len(line.split(shape.mark)) == len(below.split(shape.mark))


def _columns(cells: list[str]) -> list[int]:
    """Where x, y and z are, by their names alone or as a word of `Hoehe_NHN`; -1 where one is not there."""
    words = [{cell, *re.findall("[a-z]+", cell)} for cell in cells]
    found = []
    for names in _NAMES.values():
        alone = [k for k, cell in enumerate(cells) if cell in names]
        found.append(next((k for k in (*alone, *range(len(cells))) if words[k] & names and k not in found), -1))
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _points(source: SourceFile, most: int) -> NDArray[np.float64]:
    """Points (n, 3), or rows of heights, of a text."""
    with source.open() as raw, TextIOWrapper(cast(IO[bytes], raw), "utf-8-sig", "replace") as stream:
        first, before = "", 0
        while not _is_line(first):
            first, before = stream.readline(_LONGEST_LINE), before + 1
        shape = _shape(first)
        if shape is None:
            looked_for = "; ".join(f"{axis} by {', '.join(words.split())}" for axis, words in _WORDS.items())
            raise HeightmapError(
                f"{source.name}: its columns are {first.strip()[:80]!r}, of which not all are known: {looked_for}. "
                "Rename three of them to x, y and z",
                columns=first.strip()[:80],
            )
        lines = itertools.chain([] if shape.names else [first], iter(lambda: stream.readline(_LONGEST_LINE), ""))
        before -= not shape.names
        parts, found, columns = list[NDArray[np.float64]](), 0, 0
        while part := list(itertools.islice(lines, _PART_LINES)):
            rows = [line for line in part if _is_line(line)]
            if any(len(line) == _LONGEST_LINE for line in rows[-1:]):
                raise HeightmapError(f"{source.name} is corrupt: a line of more than {_LONGEST_LINE:,} bytes")
            if shape.commas:
                rows = [line.replace(",", ".") for line in rows]
            if rows:
                columns = columns or len(rows[0].split(shape.mark))
                parts.append(parsed(rows, columns, before, source.name, mark=shape.mark, used=shape.used))
                found += len(rows)
            before += len(part)
            check_points(found, most, source.name)
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    if shape.names and shape.used is None:
        x = np.array(shape.names[1:], dtype=np.float64)
        if points.shape[1] != x.size + 1:
            raise HeightmapError(f"{source.name}: {x.size} places above its heights, and {points.shape[1] - 1} heights")
        return np.column_stack([np.tile(x, len(points)), np.repeat(points[:, 0], x.size), points[:, 1:].ravel()])
    return points if points.shape[1] > _MOST_OF_A_POINT else points[:, :3]


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
            side = float(steps.mean())  # of centres that are rounded
            if np.abs(np.cumsum(steps) / side - np.arange(1, steps.size + 1)).max() > _ROUNDED:
                return None
        sides.append(side)
    return sides[0] if abs(sides[0] - sides[1]) <= SAME_LENGTH * sides[0] and _neighbours(x, y, sides[0]) else None


def _neighbours(x: NDArray[np.float64], y: NDArray[np.float64], side: float) -> bool:
    """Whether at least half of the points have one a step to the east or to the north: places that are rounded to
    millimetres are on a grid, too, of which nearly all cells are empty.
    """
    col, row = (np.round((values - values.min()) / side).astype(np.int64) for values in (x, y))
    long = int(col.max()) + 2
    cells = np.unique(row * long + col)
    return bool(2 * np.sum(np.isin(cells + 1, cells) | np.isin(cells + long, cells)) >= cells.size)
