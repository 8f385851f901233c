"""Files for libraries that read nothing but files on disk."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from joulemap.model.source_file import SourceFile


@contextmanager
def on_disk(source: SourceFile, suffix: str = "") -> Iterator[Path]:
    """Give a file a place on disk, for libraries that read nothing else.

    Yields: the file; a copy of bytes, or a link to a file with another ending, is gone afterwards.
    """
    if isinstance(source.place, Path) and source.place.name.endswith(suffix):
        yield source.place
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / f"log{suffix}"
        if isinstance(source.place, Path):
            place.symlink_to(source.place.resolve())
        else:
            place.write_bytes(source.place)
        yield place
