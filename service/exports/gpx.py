"""GPX 1.1: a track for each line. Tracks, not routes: a device leads along a route on roads of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree as xml

from joulemap.planner.words import duration_words, energy_words
from joulemap.service.exports.track import Track, degree_text, degrees_of

NAMESPACE = "http://www.topografix.com/GPX/1/1"


def write(track: Track) -> bytes:
    """Return a track as a GPX file.

    Reference: GPX 1.1 Schema, TopoGrafix 2004.
    """
    root = xml.Element("gpx", {"version": "1.1", "creator": "joulemap", "xmlns": NAMESPACE})
    xml.SubElement(xml.SubElement(root, "metadata"), "name").text = track.name
    for line in track.lines:
        part = xml.SubElement(root, "trk")
        xml.SubElement(part, "name").text = line.title
        xml.SubElement(part, "desc").text = described(line.properties)
        xml.SubElement(part, "type").text = line.kind
        segment = xml.SubElement(part, "trkseg")
        for (lon, lat), z in zip(degrees_of(track, line), line.points[:, 2], strict=True):
            point = xml.SubElement(segment, "trkpt", {"lat": degree_text(lat), "lon": degree_text(lon)})
            if math.isfinite(z):
                xml.SubElement(point, "ele").text = f"{z:.3f}"
    return xml.tostring(root, encoding="utf-8", xml_declaration=True)


def described(properties: dict[str, object]) -> str:
    """Return properties as one line of text.

    Result: names and values, such as "energy 14.11 kJ (3.92 Wh); length 97.1 m".
    """
    return "; ".join(_words(key, value) for key, value in properties.items() if key != "kind")


def _words(key: str, value: Any) -> str:
    """A property whose name ends with its unit, as a person reads it."""
    name, _, unit = key.rpartition("_")
    name = (name if unit in _UNITS else key).replace("_", " ")
    values = value if isinstance(value, (list, tuple)) else [value]
    return f"{name} {', '.join(_UNITS.get(unit, str)(one) for one in values)}"


_UNITS: dict[str, Callable[[Any], str]] = {
    "j": energy_words,
    "s": duration_words,
    "m": lambda metres: f"{metres:.1f} m",
    "mps": lambda speed: f"{speed:g} m/s",
}
