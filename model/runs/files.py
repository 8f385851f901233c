"""Measured runs from files, each under a name of its own, cut into segments for training."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import CARRIED, cut_segments
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.reader import read_run
from joulemap.model.runs.run import Run
from joulemap.model.runs.segments import Segments, concatenate_segments, driven_only


def distinct_names(files: Sequence[Path]) -> list[str]:
    """Return a short name for each file that no other file has.

    A name is the shortest end of the path by which the file differs from all others of the same file name:
    `run_01.csv`, or `monday/run_01.csv` and `tuesday/run_01.csv`.
    """
    paths = [file.absolute() for file in files]
    names: dict[Path, str] = {}
    for _, group in groupby(sorted(set(paths), key=lambda path: path.name), key=lambda path: path.name):
        alike = list(group)
        depth = 1
        while len({path.parts[-depth:] for path in alike}) < len(alike):
            depth += 1
        names |= {path: "/".join(path.parts[-depth:]) for path in alike}
    return [names[path] for path in paths]


def same_content(files: Sequence[Path]) -> dict[Path, Path]:
    """Return which files are copies of others: one drive under several names is one run.

    Result: by each copy, the first file with its content.
    """
    sizes = Counter(file.stat().st_size for file in files if file.is_file())
    first: dict[bytes, Path] = {}
    copies: dict[Path, Path] = {}
    for file in files:
        if file.is_file() and sizes[file.stat().st_size] > 1:
            with file.open("rb") as stream:
                content = hashlib.file_digest(stream, "blake2b").digest()
            if content in first:
                copies[file] = first[content]
            first.setdefault(content, file)
    return copies


def copies_words(copies: Mapping[Path, Path]) -> list[str]:
    """Return a sentence for each file that has copies."""
    found: dict[Path, list[str]] = {}
    for copy, first in copies.items():
        found.setdefault(first, []).append(copy.name)
    return [
        f"{first.name} is there {len(names) + 1} times, also as {', '.join(names[:3])}: it is read once"
        for first, names in found.items()
    ]


def read_alike(
    files: Sequence[Path], readers: Sequence[Callable[[Path, str, Currents], Run]], currents: Currents
) -> list[Run]:
    """Read runs of one robot, each under a name that no other file has.

    One robot has one kind of ammeter: where single runs read the signs of their currents differently, the reading of
    most rows is that of all.
    """
    given = list(zip(files, distinct_names(files), readers, strict=True))
    runs = [read(file, name, currents) for file, name, read in given]
    rows: Counter[Currents] = Counter()
    for run in runs:
        if run.currents is not None:
            rows[run.currents] += len(run)
    usual = rows.most_common(1)[0][0] if rows else currents
    return [
        run if run.currents in (None, usual) else read(file, name, usual)
        for run, (file, name, read) in zip(runs, given, strict=True)
    ]


def read_segments(
    files: Sequence[Path],
    robot: Robot,
    *,
    crs: str | None,
    charge: bool = False,
    currents: Currents = "auto",
    length_m: float | None = None,
) -> tuple[list[Run], Segments]:
    """Read runs for training: every run, and the segments of all in joules.

    Result: a run without a voltage counts with its charge times the nominal voltage.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")

    def _read(file: Path, name: str, how: Currents) -> Run:
        return read_run(file, name=name, crs=crs, currents=how)

    runs = read_alike(files, [_read] * len(files), currents)
    parts = []
    for run in runs:
        counted = charge or not run.has_energy
        fastest = CARRIED * robot.speed_mps
        cut = cut_segments(run, length_m=length_m, charge=counted, max_speed_mps=fastest)
        parts.append(replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v, charge=False) if counted else cut)
    return runs, driven_only(concatenate_segments(parts))
