"""A path read from a file: GeoJSON, the JSON of an answer, or CSV."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import PointError


def read_path(file: Path) -> list[list[float]]:
    """The points [[x, y], ...] of a GeoJSON line, of a document with `path`, or of lines `x,y` (a heading is skipped).

    Of several GeoJSON lines the first is taken. Raises PointError where the file holds none of them.
    """
    text = file.read_text(encoding="utf-8-sig")
    try:
        points = _from_json(json.loads(text)) if text.lstrip()[:1] in ("{", "[") else _from_lines(text)
        array = np.array([[float(v) for v in point[:2]] for point in points])
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise PointError(f"{file} holds no path that can be read: {error}", path=str(file)) from error
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 1:
        raise PointError(f"{file} holds no path: a list of x,y points is needed", path=str(file))
    return array.tolist()


def _from_json(document: Any) -> list[Any]:
    if isinstance(document, list):
        return document
    if document.get("type") == "FeatureCollection":
        return _from_json(document["features"][0])
    if document.get("type") == "Feature":
        return document["geometry"]["coordinates"]
    return document["coordinates"] if document.get("type") == "LineString" else document["path"]


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
