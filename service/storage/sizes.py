"""How much space a file or a folder takes."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def bytes_of(place: Path) -> int:
    """Return the size of a file, or of all files in a folder. What disappears meanwhile does not count."""
    if not place.is_dir():
        return place.stat().st_size if place.exists() else 0
    total = 0
    for folder, _, names in os.walk(place):  # passes over a folder that disappears, at which `Path.rglob` ends
        for name in names:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total
