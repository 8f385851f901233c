"""Tracks in XML with what was measured at their points: GPX with its extensions, and TCX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import stream_of
from joulemap.model.runs.formats.contract import Log
from joulemap.model.runs.formats.json_records import columns_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_POINTS = ("trkpt", "Trackpoint")
_DOCUMENTS = (b"<gpx", b"<TrainingCenterDatabase")


def recognise(head: bytes, name: str) -> bool:
    """Decide by the first element, or by the name where comments hide it."""
    xml = head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
    return xml and (any(mark in head for mark in _DOCUMENTS) or name.lower().endswith((".gpx", ".tcx")))


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the points."""
    name = source.name
    notes: list[str] = []
    table = columns_of(_points(source, notes), name, limits)
    if not table.num_rows:
        raise RunsError.of_run(name, f"the track in XML has no points{'; ' + notes[0] if notes else ''}")
    return Log((stream_of(table, name, limits),), notes=tuple(notes))


def _points(source: SourceFile, notes: list[str]) -> Iterator[dict[str, Any]]:
    """Attributes and texts inside each point; a file that breaks off is read so far, with a note."""
    with source.open() as stream:
        try:
            for _, element in ElementTree.iterparse(stream):
                if element.tag.rpartition("}")[2] in _POINTS:
                    record: dict[str, Any] = dict(element.attrib)
                    for inner in element.iter():
                        if inner is not element and len(inner) == 0 and inner.text:
                            record.setdefault(inner.tag.rpartition("}")[2], inner.text.strip())
                    element.clear()
                    yield record
        except ElementTree.ParseError as error:
            notes.append(f"the track in XML breaks off: {str(error)[:120]}. What comes before is kept")
