"""ArduPilot dataflash logs (.bin, or .log as text): battery (BAT), receiver (GPS), position (POS), attitude (ATT)."""

from __future__ import annotations

import math
import mmap
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.recordings.places import on_disk
from joulemap.model.runs.formats.contract import Log, Stream, mentioned
from joulemap.model.runs.formats.finite import FiniteMap, fill_at, filled
from joulemap.model.runs.formats.messages import Collector, cut_off, fields_by_kind, log_of, reading, wanted_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_MAGIC = b"\xa3\x95\x80"  # the first message describes the format of such messages
_TEXT = b"FMT, 128, 89"  # the same as text
_WANTED = wanted_of(
    {
        "voltage": "BAT.Volt:V CURR.Volt:V",
        "current": "BAT.Curr:A CURR.Curr:A",
        "lat": "POS.Lat:deg GPS.Lat:deg",
        "lon": "POS.Lng:deg GPS.Lng:deg",
        "x": "XKF1.PE:m",
        "y": "XKF1.PN:m",
        "z": "POS.Alt:m GPS.Alt:m",
        "heading": "ATT.Yaw:deg",
        "roll": "ATT.Roll:deg",
        "pitch": "ATT.Pitch:deg",
        "speed": "GPS.Spd:m/s",
    }
)
_FIELDS = fields_by_kind(_WANTED)
_INSTANCES = ("Inst", "Instance", "I", "C")
_MARK, _FORMAT, _FORMAT_BYTES = b"\xa3\x95", 0x80, 89
_MOST_STRANGE = 100_000  # marks of no message, behind which no end is looked for
_PAGE_BYTES = 528  # of a memory card: the library looks for no marks in so much at the end


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of the first message."""
    return head.startswith(_MAGIC) or head.lstrip().startswith(_TEXT)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the messages that a run needs. Result: a stream for each kind of message, and for each instance of it."""
    from pymavlink.DFReader import DFReader_binary, DFReader_text

    class _Reader(DFReader_binary):
        """Lists the messages in Python: the compiled way writes a line to the terminal for each bad byte."""

        def init_arrays_fast(self, progress_callback: Any = None) -> None:
            seen.append(FiniteMap(vars(self)["data_map"]))
            self.data_map, self.data_len = seen[0], end
            self.init_arrays(progress_callback)

    collector = Collector(source.name, limits)
    log: Any = None
    seen: list[FiniteMap] = []

    def _place() -> str:
        return f"at byte {seen[0].at:,} of {source.size_bytes:,}" if seen else "at its begin"

    with on_disk(source) as path, reading("ArduPilot log", source.name, _place):
        text = source.head.lstrip().startswith(_TEXT)
        end, notes = (source.size_bytes, []) if text else _about_end(path)
        try:
            log = (DFReader_text if text else _Reader)(str(path), zero_time_base=True)
            known = set(log.name_to_id)
            wanted = [kind for kind in known if kind in _FIELDS or any(_names(mapping, kind))]
            if not wanted:
                raise RunsError.of_run(
                    source.name,
                    f"the log has no messages BAT, GPS or POS; its kinds are {', '.join(sorted(known))[:300]}",
                )
            while (message := log.recv_match(type=wanted)) is not None:
                kind = message.get_type()
                fields = message.get_fieldnames()
                number = next((int(getattr(message, key)) for key in _INSTANCES if key in fields), 0)
                topic = f"{kind}[{number}]" if number else kind
                keys = fields if mentioned(mapping, topic) else [key for key in fields if key in _FIELDS.get(kind, ())]
                values = {key: float(v) for key in keys if isinstance(v := getattr(message, key), (int, float))}
                if kind == "GPS" and getattr(message, "Status", 3) < 2:  # no fix
                    values |= {"Lat": math.nan, "Lng": math.nan, "Alt": math.nan}
                if "TimeUS" in fields:
                    collector.add(topic, float(message.TimeUS) * 1e-6, values)
                elif "TimeMS" in fields:  # before 2015
                    collector.add(topic, float(message.TimeMS) * 1e-3, values)
        finally:
            if log is not None:
                log.close()
    found = log_of(collector.streams(), _WANTED, notes=notes)
    meters = [stream for stream in found.streams if stream.name.startswith("BAT") and _counts(stream)]
    packs = tuple((f"{stream.name}.Volt", f"{stream.name}.Curr") for stream in meters)
    return replace(found, packs=packs if len(packs) > 1 else ())


def _counts(stream: Stream) -> bool:
    """Whether this battery gives a current."""
    values = [stream.numbers.get(f"{stream.name}.{key}") for key in ("Volt", "Curr")]
    return all(column is not None and np.nan_to_num(column).any() for column in values)


def _about_end(path: Path) -> tuple[int, list[str]]:
    """Where the log ends for the library [bytes], and a note where the last message is not whole.

    What follows it without a mark fills the page of the memory card; more than that is said.
    """
    lengths = {_FORMAT: _FORMAT_BYTES}
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = end = strange = 0
        size = len(data)
        while (at := data.find(_MARK, at)) >= 0:
            # one byte further where something in between looks like a mark
            length = lengths.get(data[at + 2], 1) if at + 3 <= size else 3
            strange += length == 1
            if strange > _MOST_STRANGE:
                return size, []
            if at + length > size:
                return size, [cut_off("ArduPilot log", at, size)]
            if data[at + 2] == _FORMAT:
                lengths[data[at + 3]] = max(data[at + 4], 3)
            at = end = at + length
    if size - end > _PAGE_BYTES and fill_at(path) <= end:
        return end, [filled("ArduPilot log", path, end)]
    return size, []


def _names(mapping: Mapping[str, str], kind: str) -> list[str]:
    return [source for source in mapping.values() if f"{kind}." in source or f"{kind}[" in source]
