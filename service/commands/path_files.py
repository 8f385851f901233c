"""A path read from a file: GeoJSON, the JSON of an answer, or CSV."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import PointError

_GAP_M = 0.01  # lines of a tour touch but for what a writer rounds off
_BESIDE = ("shortest", "alternative")  # `kind` of the lines that `joulemap path` writes beside its answer


def read_path(file: Path) -> list[list[float]]:
    """Return the points of a path in a file.

    Several lines, as a tour has them, are driven one after another: each has to begin where the one before ends. Of the
    lines that `joulemap path` writes, the energy-optimal one is taken.

    Parameters
    ----------
    file : Path
        GeoJSON with lines, the JSON of an answer with `path`, a JSON list of points, or text lines `x,y` after at most
        one line of headings.

    Returns
    -------
    list of list of float
        (n, 2) x, y [m].

    Raises
    ------
    PointError
        If the file holds none of them, or its lines do not touch.
    """
    text = file.read_text(encoding="utf-8-sig")
    try:
        lines = _from_json(json.loads(text)) if text.lstrip()[:1] in ("{", "[") else [_from_lines(text)]
        arrays = [np.array([[float(v) for v in point[:2]] for point in line]) for line in lines]
    except (ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise PointError(f"{file} holds no path that can be read: {error}", path=str(file)) from error
    if not arrays or any(line.ndim != 2 or line.shape[1] != 2 or len(line) < 1 for line in arrays):
        raise PointError(f"{file} holds no path: a list of x,y points is needed", path=str(file))
    return _joined(arrays, file)


def _joined(lines: list[NDArray[np.float64]], file: Path) -> list[list[float]]:
    """One line of lines that touch."""
    path = lines[0].tolist()
    for number, line in enumerate(lines[1:], start=2):
        (x0, y0), (x1, y1) = path[-1], line[0]
        if not (gap := math.dist((x0, y0), (x1, y1))) <= _GAP_M:
            raise PointError(
                f"{file}: line {number - 1} ends at ({x0:.2f}, {y0:.2f}), but line {number} begins at ({x1:.2f}, "
                f"{y1:.2f}), {gap:.2f} m away: give one path, or lines that touch",
                path=str(file),
                line=number,
                gap_m=gap,
            )
        path += line[1:].tolist()
    return path


def _from_json(document: Any) -> list[Any]:
    """The lines of a document, in their order."""
    if isinstance(document, list):
        return [document]
    kind = document.get("type")
    if kind == "FeatureCollection":
        features = [f for f in document["features"] if (f.get("properties") or {}).get("kind") not in _BESIDE]
        return [line for feature in features for line in _from_json(feature)]
    if kind == "Feature":
        return _from_json(document["geometry"] or {"type": "Point"})
    if kind == "GeometryCollection":
        return [line for geometry in document["geometries"] for line in _from_json(geometry)]
    if kind == "LineString":
        return [document["coordinates"]]
    if kind == "MultiLineString":
        return list(document["coordinates"])
    if kind in ("Point", "MultiPoint", "Polygon", "MultiPolygon"):
        return []  # places beside the path
    return [document["path"]] if "path" in document else [leg["path"] for leg in document["legs"]]


def _from_lines(text: str) -> list[list[float]]:
    rows = [line.replace(";", ",").split(",") for line in text.splitlines() if line.strip()]
    if rows and not _is_number(rows[0][0]):
        rows = rows[1:]
    return [[float(cell) for cell in row[:2]] for row in rows]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
