"""Measured runs as a calibration takes them: to learn from, to hold them against, and kept aside to judge by."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from model.errors import RunsError
from model.loop.odometry import Odometry, cut_travel, flat_heightmap, read_odometry
from model.loop.runs import Run, read_run
from model.loop.segments import CARRIED, Segments, concatenate, cut_segments, driven_only
from model.robot import Robot
from model.terrain.heightmap import Heightmap


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationRuns:
    """segments : of the runs to learn from, in joules, or in ampere seconds where no run has a voltage. base : of runs
    in which nothing new is at work. aside : of runs that are neither sought nor fitted in, only judged by. rows : of
    all files. repairs : by run and rule. placed : whether their positions are places, and not only the way that the
    wheels went."""

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
    have a voltage."""

    def cut(run: Run, charge: bool) -> Segments:
        return cut_segments(run, charge=charge, max_speed_mps=CARRIED * robot.speed_mps)

    read = [[read_run(file, crs=crs) for file in some] for some in (files, base_files, aside_files)]
    return _cut((files, base_files, aside_files), read, cut)


def read_odometry_runs(
    files: Sequence[Path],
    odometry: Odometry,
    *,
    base_files: Sequence[Path] = (),
    aside_files: Sequence[Path] = (),
) -> tuple[CalibrationRuns, Heightmap]:
    """Runs without positions, whose wheel speeds are integrated, and level ground under all of them. Raises RunsError
    as `read_calibration_runs`."""
    read = [[read_odometry(file, odometry) for file in some] for some in (files, base_files, aside_files)]
    runs = _cut((files, base_files, aside_files), read, lambda run, charge: cut_travel(run, charge=charge))
    return replace(runs, placed=False), flat_heightmap([run for some in read for run in some])


def _cut(
    files: tuple[Sequence[Path], ...], read: list[list[Run]], cut: Callable[[Run, bool], Segments]
) -> CalibrationRuns:
    if not files[0]:
        raise RunsError("there is no run to read: no file has such a name")
    read = [_named_apart(some, runs) for some, runs in zip(files, read, strict=True)]
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


def _named_apart(files: Sequence[Path], runs: list[Run]) -> list[Run]:
    """Runs of one name in several folders, with their folders' names."""
    names = Counter(file.name for file in files)
    return [
        replace(run, name=f"{file.parent.name}/{run.name}") if names[file.name] > 1 else run
        for run, file in zip(runs, files, strict=True)
    ]
