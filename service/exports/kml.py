"""KML 2.2: a placemark for each line, laid onto the ground."""

from __future__ import annotations

import math
from xml.etree import ElementTree as xml

from joulemap.service.exports.track import Track, degree_text, degrees_of

NAMESPACE = "http://www.opengis.net/kml/2.2"


def write(track: Track) -> bytes:
    """Return a track as a KML file.

    Reference: OGC 07-147r2, KML 2.2.
    """
    root = xml.Element("kml", {"xmlns": NAMESPACE})
    document = xml.SubElement(root, "Document")
    xml.SubElement(document, "name").text = track.name
    for line in track.lines:
        mark = xml.SubElement(document, "Placemark")
        xml.SubElement(mark, "name").text = line.title
        data = xml.SubElement(mark, "ExtendedData")
        for key, value in line.properties.items():
            xml.SubElement(xml.SubElement(data, "Data", {"name": key}), "value").text = str(value)
        shape = xml.SubElement(mark, "LineString")
        xml.SubElement(shape, "tessellate").text = "1"
        xml.SubElement(shape, "altitudeMode").text = "clampToGround"
        xml.SubElement(shape, "coordinates").text = " ".join(
            f"{degree_text(lon)},{degree_text(lat)}" + (f",{z:.3f}" if math.isfinite(z) else "")
            for (lon, lat), z in zip(degrees_of(track, line), line.points[:, 2], strict=True)
        )
    return xml.tostring(root, encoding="utf-8", xml_declaration=True)
