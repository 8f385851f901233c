"""Virtual rasters: which files they name."""

from __future__ import annotations

import html
import re
from pathlib import Path

from joulemap.model.errors import HeightmapError

MARK = b"<VRTDataset"
"""The element that such a file begins with."""

_MAX_BYTES = 10_000_000
_MOST_LEVELS = 8  # one within the other
_HEAD_BYTES = 512
_NAMES = re.compile(
    r"<(?:SourceFilename|SourceDataset)\b[^>]*>([^<]*)|(/vsi|CDATA|(?:SourceFilename|SourceDataset)\s*=)"
)


def is_vrt(head: bytes) -> bool:
    """Decide by the first element."""
    plain = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return (plain.partition(b"?>")[2].lstrip() if plain.startswith(b"<?xml") else plain).startswith(MARK)


def check_names(path: Path, *, levels: int = _MOST_LEVELS) -> None:
    """Refuse a VRT that names anything but files on this machine which are rasters themselves."""
    text = path.read_bytes()[: _MAX_BYTES + 1].decode("utf-8", "replace")
    if len(text) > _MAX_BYTES or levels == 0:
        raise HeightmapError(f"{path.name} is a VRT of more than {_MAX_BYTES:,} bytes, or of VRTs of VRTs")
    for match in _NAMES.finditer(text):
        name = html.unescape(match.group(1) or "")
        there = path.parent / name
        if match.group(2) or not name or not there.is_file():
            raise HeightmapError(
                f"the VRT {path.name} names {(name or match.group(2))[:200]!r}, which is no file on this machine"
            )
        with there.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        if is_vrt(head):
            check_names(there, levels=levels - 1)
        elif head.lstrip()[:1] in (b"<", b"{", b"["):
            raise HeightmapError(f"the VRT {path.name} names {name[:200]!r}, which is no raster")
