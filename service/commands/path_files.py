"""A path read from a file: what `joulemap path` and `tour` write, or what another program wrote in these formats."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import PointError
from joulemap.model.frames import GridFrame
from joulemap.service.exports.mission import WAYPOINT
from joulemap.service.exports.track import BESIDE
from joulemap.service.places.areas_given import geometries
from joulemap.service.places.coordinates import from_wgs84, on_map, to_wgs84

_GAP_M = 0.02  # lines of a tour touch but for what a writer rounds off, at both ends
_EARTH = ("OGC:CRS84", "urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:OGC::CRS84", "EPSG:4326")

_UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    RecursionError,
    OverflowError,
    xml.ParseError,
    csv.Error,
)
"""What a file raises that is not what it claims to be."""

_Lines = list[list[Any]]


@dataclass
class _Found:
    """Lines of a file: x, y [m]; or, in degrees, longitude, latitude; or GeoJSON that does not say which."""

    lines: _Lines
    degrees: bool | None = False
    crs: str | None = None
    notes: list[str] = field(default_factory=list)


def read_path(file: Path, frame: GridFrame) -> tuple[list[list[float]], list[str]]:
    """Return the points of a path in a file.

    Several lines, as a tour has them, are driven one after another: each has to begin where the one before ends. Of the
    lines that `joulemap path` writes, the energy-optimal one is taken.

    Raises PointError if the file holds no path, or its lines do not touch. Raises InputError if it is in degrees and
    the map has no CRS.
    """
    try:
        found = _lines_of(file.read_text(encoding="utf-8-sig"))
        arrays = [np.array([[float(v) for v in point[:2]] for point in line]) for line in found.lines]
    except _UNREADABLE as error:
        raise PointError(f"{file} holds no path that can be read: {str(error)[:200]}", path=str(file)) from error
    if not arrays or any(line.ndim != 2 or line.shape[1] != 2 or len(line) < 1 for line in arrays):
        raise PointError(f"{file} holds no path: a list of x,y points is needed", path=str(file))
    return _joined([_on(frame, line, found) for line in arrays], file), found.notes


def read_areas(file: Path | None, frame: GridFrame) -> tuple[list[list[list[float]]], list[str]]:
    """Return the areas in a GeoJSON file; their holes are not left out.

    Raises PointError if the file holds no polygons. Raises InputError if it is in degrees and the map has no CRS.
    """
    if file is None:
        return [], []
    try:
        document = json.loads(file.read_text(encoding="utf-8-sig"))
        outlines = [one["coordinates"][0] for one, _ in geometries(document) if one["type"] == "Polygon"]
        found = _referenced(document, outlines)
        rings = [np.array([[float(v) for v in corner[:2]] for corner in ring]) for ring in found.lines]
    except _UNREADABLE as error:
        raise PointError(f"{file} holds no areas that can be read: {str(error)[:200]}", path=str(file)) from error
    if not rings or any(ring.ndim != 2 or ring.shape[1] != 2 for ring in rings):
        raise PointError(f"{file} holds no areas: GeoJSON with polygons is needed", path=str(file))
    return [_on(frame, ring, found)[:-1].tolist() for ring in rings], found.notes


def _on(frame: GridFrame, line: NDArray[np.float64], found: _Found) -> NDArray[np.float64]:
    """A line in the coordinates of the map."""
    if found.degrees is None:
        found.degrees = frame.crs is not None and not on_map(frame, *line[0])
        if not found.degrees and frame.crs is not None:
            found.notes.append(
                "the GeoJSON has no member `crs`; its points lie on the map as x, y and were read so, not as "
                "longitude, latitude"
            )
    if found.degrees:
        return from_wgs84(frame.crs, line)
    if found.crs is not None and frame.crs is not None and found.crs != frame.crs:
        return from_wgs84(frame.crs, to_wgs84(found.crs, line))
    return line


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


def _lines_of(text: str) -> _Found:
    begin = text.lstrip()[:1]
    if begin in ("{", "["):
        return _from_json(json.loads(text))
    if begin == "<":
        return _from_xml(text)
    if text.startswith("QGC WPL"):
        rows = [line.split() for line in text.splitlines()[1:] if line.strip()]
        return _Found([[[float(r[9]), float(r[8])] for r in rows[1:] if int(r[3]) == WAYPOINT]], degrees=True)
    return _from_table(text)


def _from_json(document: Any) -> _Found:
    if isinstance(document, list):
        return _Found([document])
    if document.get("fileType") == "Plan":
        items = [item for item in document["mission"]["items"] if item["command"] == WAYPOINT]
        return _Found([[item["params"][5:3:-1] for item in items]], degrees=True)
    if "poses" in document:
        places = [pose["pose"]["position"] for pose in document["poses"]]
        return _Found([[[place["x"], place["y"]] for place in places]])
    if document.get("type") is None:
        return _Found([document["path"]] if "path" in document else [leg["path"] for leg in document["legs"]])
    return _referenced(document, _from_geojson(document))


def _referenced(document: Any, lines: _Lines) -> _Found:
    """Lines of GeoJSON with what it says about its coordinates."""
    name = ((document.get("crs") or {}).get("properties") or {}).get("name")
    degrees = True if "map_crs" in document or name in _EARTH else None if name is None else False
    return _Found(lines, degrees=degrees, crs=name)


def _from_geojson(document: Any) -> _Lines:
    """The lines of a document, in their order; other places are beside the path."""
    lines = ((one["coordinates"], of) for one, of in geometries(document) if one["type"] == "LineString")
    return [line for line, of in lines if of.get("kind") not in BESIDE]


def _from_xml(text: str) -> _Found:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("XML with a document type is not read")
    root = xml.fromstring(text)
    own = _named(root, "trk", "rte") or _named(root, "Placemark")
    lines = [line for part in own if not _is_beside(part) for line in _lines_in(part)]
    return _Found([line for line in lines if line], degrees=True)


def _lines_in(part: xml.Element) -> Iterator[list[Any]]:
    points = _named(part, "trkpt", "rtept")
    if points:
        yield [[point.attrib["lon"], point.attrib["lat"]] for point in points]
    for line in _named(part, "LineString"):
        for text in _named(line, "coordinates"):
            yield [place.split(",") for place in (text.text or "").split()]


def _is_beside(part: xml.Element) -> bool:
    kinds = [value.text for value in _named(part, "type")]
    kinds += [value.text for data in _named(part, "Data") if data.get("name") == "kind" for value in data]
    return any(kind in BESIDE for kind in kinds)


def _named(root: xml.Element, *names: str) -> list[xml.Element]:
    """The parts of these names, whatever their namespace."""
    return [part for part in root.iter() if part.tag.rsplit("}", 1)[-1] in names]


def _from_table(text: str) -> _Found:
    rows = [row for row in csv.reader(text.replace(";", ",").splitlines()) if any(cell.strip() for cell in row)]
    if not rows or _is_number(rows[0][0]):
        return _Found([_numbers(rows, (0, 1))])
    names = [cell.strip().lower() for cell in rows[0]]
    xy = _columns(names, (("x_m", "x", "easting"), ("y_m", "y", "northing")))
    lonlat = _columns(names, (("longitude_deg", "longitude", "lon", "lng"), ("latitude_deg", "latitude", "lat")))
    if xy is None and lonlat is not None:
        return _Found([_numbers(rows[1:], lonlat)], degrees=True)
    return _Found([_numbers(rows[1:], xy or (0, 1))])


def _columns(names: list[str], wanted: tuple[tuple[str, ...], tuple[str, ...]]) -> tuple[int, int] | None:
    found = [next((names.index(name) for name in known if name in names), None) for known in wanted]
    return None if found[0] is None or found[1] is None else (found[0], found[1])


def _numbers(rows: Iterable[list[str]], columns: tuple[int, int]) -> list[Any]:
    return [[float(row[k]) for k in columns] for row in rows]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
