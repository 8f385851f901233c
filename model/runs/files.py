"""Measured runs from files: each with a name of its own, cut into segments, for training and for calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.odometry import Odometry, cut_travel, flat_heightmap, read_odometry
from joulemap.model.runs.reader import Run, read_run
from joulemap.model.runs.segments import CARRIED, Segments, concatenate, cut_segments, driven_only
from joulemap.model.terrain.heightmap import Heightmap


def distinct_names(files: Sequence[Path]) -> list[str]:
    """A name of each file that no other one has: the shortest end of its path that tells it from all files of the same
    name (`run_01.csv`, or `monday/run_01.csv` and `tuesday/run_01.csv`).
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


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationRuns:
    """segments : of the runs to learn from, in joules, or in ampere seconds where no run has a voltage. base : of runs
    in which nothing new is at work. aside : of runs that are neither sought nor fitted in, only judged by. rows : of
    all files. repairs : by run and rule. placed : whether their positions are places, and not only the way that the
    wheels went.
    """

    segments: Segments
    base: Segments | None
    aside: Segments | None
    rows: int
    repairs: dict[str, dict[str, int]]
    placed: bool = True


def read_calibration_runs(
    files: Sequence[Path],
    robot: Robot,
    *,
    crs: str | None,
    base_files: Sequence[Path] = (),
    aside_files: Sequence[Path] = (),
) -> CalibrationRuns:
    """Runs with positions. crs : for `lat` and `lon`. Raises RunsError for no run to learn from, or where only some
    have a voltage.
    """

    def cut(run: Run, charge: bool) -> Segments:
        return cut_segments(run, charge=charge, max_speed_mps=CARRIED * robot.speed_mps)

    read = _read((files, base_files, aside_files), lambda file, name: read_run(file, name=name, crs=crs))
    return _cut(read, cut)


def read_odometry_runs(
    files: Sequence[Path],
    odometry: Odometry,
    *,
    base_files: Sequence[Path] = (),
    aside_files: Sequence[Path] = (),
) -> tuple[CalibrationRuns, Heightmap]:
    """Runs without positions, whose wheel speeds are integrated, and level ground under all of them. Raises RunsError
    as `read_calibration_runs`.
    """
    read = _read((files, base_files, aside_files), lambda file, name: read_odometry(file, odometry, name=name))
    runs = _cut(read, lambda run, charge: cut_travel(run, charge=charge))
    return replace(runs, placed=False), flat_heightmap([run for some in read for run in some])


def _read(files: Sequence[Sequence[Path]], read: Callable[[Path, str], Run]) -> list[list[Run]]:
    """The runs of each sequence of files, no two of different files under one name."""
    if not files[0]:
        raise RunsError("there is no run to read: no file has such a name")
    names = iter(distinct_names([file for some in files for file in some]))
    return [[read(file, next(names)) for file in some] for some in files]


def _cut(read: list[list[Run]], cut: Callable[[Run, bool], Segments]) -> CalibrationRuns:
    every = [run for some in read for run in some]
    without = [run.name for run in every if run.voltage_v is None]
    if without and len(without) < len(every):
        raise RunsError(
            f"{len(without)} of {len(every)} runs have no voltage (the first is {without[0]}): calibrate them apart",
            run=without[0],
        )
    segments, base, aside = (
        driven_only(concatenate([cut(run, bool(without)) for run in some])) if some else None for some in read
    )
    assert segments is not None
    repairs = {run.name: run.repairs for run in every if run.repairs}
    return CalibrationRuns(segments, base, aside, sum(len(run) for run in every), repairs)


def read_segments(
    files: Sequence[Path], robot: Robot, *, crs: str | None, charge: bool = False
) -> tuple[list[Run], Segments]:
    """Every run, and their 1 m segments in joules.

    Of a run without voltage, and of every run if `charge`, the energy is its charge times the robot's nominal voltage.
    Raises RunsError.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")
    runs = [read_run(file, name=name, crs=crs) for file, name in zip(files, distinct_names(files), strict=True)]
    parts = []
    for run in runs:
        counted = charge or run.voltage_v is None
        cut = cut_segments(run, charge=counted, max_speed_mps=CARRIED * robot.speed_mps)
        parts.append(replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v, charge=False) if counted else cut)
    return runs, driven_only(concatenate(parts))
