"""How much space a file or a folder takes."""

from __future__ import annotations

from pathlib import Path


def bytes_of(place: Path) -> int:
    """Return the size of a file, or of all files in a folder.

    Parameters
    ----------
    place : Path
        Of a file, a folder, or nothing.

    Returns
    -------
    int
        Bytes; 0 where there is nothing. A file that disappears meanwhile does not count.
    """
    if not place.is_dir():
        return place.stat().st_size if place.exists() else 0
    total = 0
    for path in place.rglob("*"):
        try:
            if path.is_file():
                total += path.stat().st_size
        except FileNotFoundError:
            continue
    return total
