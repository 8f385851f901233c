"""What runs are called: each by its file's name, and by its folders' too where another file has the same."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path


def distinct_names(files: Sequence[Path]) -> list[str]:
    """A name of each file that no other one has: the shortest end of its path that tells it from all files of the same
    name (`run_01.csv`, or `monday/run_01.csv` and `tuesday/run_01.csv`)."""
    paths = [file.absolute() for file in files]
    names: dict[Path, str] = {}
    for _, group in groupby(sorted(set(paths), key=lambda path: path.name), key=lambda path: path.name):
        alike = list(group)
        depth = 1
        while len({path.parts[-depth:] for path in alike}) < len(alike):
            depth += 1
        names |= {path: "/".join(path.parts[-depth:]) for path in alike}
    return [names[path] for path in paths]
