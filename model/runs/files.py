"""Measured runs from files, each under a name of its own, cut into segments for training and calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import CARRIED, Protocol, cut_segments
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.odometry import Odometry, cut_travel, flat_heightmap, read_odometry
from joulemap.model.runs.reader import Run, read_run
from joulemap.model.runs.segments import Segments, concatenate, driven_only
from joulemap.model.terrain.heightmap import Heightmap


def distinct_names(files: Sequence[Path]) -> list[str]:
    """Return a short name for each file that no other file has.

    A name is the shortest end of the path by which the file differs from all others of the same file name:
    `run_01.csv`, or `monday/run_01.csv` and `tuesday/run_01.csv`.

    Parameters
    ----------
    files : sequence of Path
        The same file may occur twice.

    Returns
    -------
    list of str
        In the order of `files`.
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
    """The runs that a calibration reads, as segments.

    Attributes
    ----------
    segments : Segments
        Of the runs to learn from: energy in J, or charge in A s where no run has a voltage.
    baseline : Segments, optional
        Of runs in which nothing new happens.
    test : Segments, optional
        Of runs that take no part in the fit and are only predicted.
    rows : int
        Of all files.
    repairs : dict
        Counts by name of the run and rule.
    placed : bool
        Whether positions are places on a map. False where they are integrated from wheel speeds.
    """

    segments: Segments
    baseline: Segments | None
    test: Segments | None
    rows: int
    repairs: dict[str, dict[str, int]]
    placed: bool = True


def read_calibration_runs(
    files: Sequence[Path],
    robot: Robot,
    *,
    crs: str | None,
    baseline_files: Sequence[Path] = (),
    test_files: Sequence[Path] = (),
    protocol: Protocol = "track",
    currents: Currents = "auto",
) -> CalibrationRuns:
    """Read runs with positions.

    Parameters
    ----------
    files : sequence of Path
        Of the runs to learn from.
    robot : Robot
        That drove; segments far above its speed are left out.
    crs : str, optional
        The heightmap's CRS, needed for `lat` and `lon`.
    baseline_files : sequence of Path
        Of runs in which nothing new happens.
    test_files : sequence of Path
        Of runs for the test only.
    protocol : {"track", "chords"}
        As in `cut_segments`.
    currents : {"auto", "signed", "magnitude"}
        How the currents of several motors are summed (`joulemap.model.runs.electric`).

    Returns
    -------
    CalibrationRuns
        Of all files.

    Raises
    ------
    RunsError
        If there is no run to learn from, if a file is no run, or if only some runs have a voltage.
    """

    def _cut_one(run: Run, charge: bool) -> Segments:
        return cut_segments(run, charge=charge, protocol=protocol, max_speed_mps=CARRIED * robot.speed_mps)

    read = _read(
        (files, baseline_files, test_files),
        lambda file, name, how: read_run(file, name=name, crs=crs, currents=how),
        currents,
    )
    return _cut(read, _cut_one)


def read_odometry_runs(
    files: Sequence[Path],
    odometry: Odometry,
    *,
    baseline_files: Sequence[Path] = (),
    test_files: Sequence[Path] = (),
    currents: Currents = "auto",
) -> tuple[CalibrationRuns, Heightmap]:
    """Read runs without positions, whose wheel speeds are integrated, and make flat ground for them.

    Parameters
    ----------
    files : sequence of Path
        Of the runs to learn from.
    odometry : Odometry
        How wheel speeds become a track.
    baseline_files : sequence of Path
        Of runs in which nothing new happens.
    test_files : sequence of Path
        Of runs for the test only.
    currents : {"auto", "signed", "magnitude"}
        As in `read_calibration_runs`.

    Returns
    -------
    tuple of (CalibrationRuns, Heightmap)
        The heightmap covers all runs.

    Raises
    ------
    RunsError
        As `read_calibration_runs`.
    """
    read = _read(
        (files, baseline_files, test_files),
        lambda file, name, how: read_odometry(file, odometry, name=name, currents=how),
        currents,
    )
    runs = _cut(read, lambda run, charge: cut_travel(run, charge=charge))
    return replace(runs, placed=False), flat_heightmap([run for some in read for run in some])


def _read(
    files: Sequence[Sequence[Path]], read: Callable[[Path, str, Currents], Run], currents: Currents
) -> list[list[Run]]:
    """The runs of each sequence of files; no two different files have the same name.

    One robot has one kind of ammeter: where single runs read the signs of their currents differently, the reading of
    most rows is that of all.
    """
    if not files[0]:
        raise RunsError("there is no run to read: no file has such a name")
    names = iter(distinct_names([file for some in files for file in some]))
    named = [[(file, next(names)) for file in some] for some in files]
    runs = [[read(file, name, currents) for file, name in some] for some in named]
    rows: Counter[Currents] = Counter()
    for run in (run for some in runs for run in some):
        if run.currents is not None:
            rows[run.currents] += len(run)
    usual = rows.most_common(1)[0][0] if rows else currents
    return [
        [
            run if run.currents in (None, usual) else read(file, name, usual)
            for run, (file, name) in zip(some, pairs, strict=True)
        ]
        for some, pairs in zip(runs, named, strict=True)
    ]


def _cut(read: list[list[Run]], cut: Callable[[Run, bool], Segments]) -> CalibrationRuns:
    every = [run for some in read for run in some]
    without = [run.name for run in every if not run.has_energy]
    if without and len(without) < len(every):
        raise RunsError(
            f"{len(without)} of {len(every)} runs have no voltage (the first is {without[0]}): calibrate them "
            "separately",
            run=without[0],
        )
    segments, baseline, test = (
        driven_only(concatenate([cut(run, bool(without)) for run in some])) if some else None for some in read
    )
    assert segments is not None
    repairs = {run.name: run.repairs for run in every if run.repairs}
    return CalibrationRuns(segments, baseline, test, sum(len(run) for run in every), repairs)


def read_segments(
    files: Sequence[Path],
    robot: Robot,
    *,
    crs: str | None,
    charge: bool = False,
    protocol: Protocol = "track",
    currents: Currents = "auto",
) -> tuple[list[Run], Segments]:
    """Read runs for training: every run, and the segments of all in joules.

    Parameters
    ----------
    files : sequence of Path
        At least one.
    robot : Robot
        Its nominal voltage turns charge into energy.
    crs : str, optional
        The heightmap's CRS, needed for `lat` and `lon`.
    charge : bool
        Use the charge of every run, also of those with a voltage.
    protocol : {"track", "chords"}
        As in `cut_segments`.
    currents : {"auto", "signed", "magnitude"}
        How the currents of several motors are summed (`joulemap.model.runs.electric`).

    Returns
    -------
    tuple of (list of Run, Segments)
        In the order of `files`. A run without a voltage counts with its charge times the nominal voltage.

    Raises
    ------
    RunsError
        If there is no file, or one is no run.
    """
    (runs,) = _read((files,), lambda file, name, how: read_run(file, name=name, crs=crs, currents=how), currents)
    parts = []
    for run in runs:
        counted = charge or not run.has_energy
        cut = cut_segments(run, charge=counted, protocol=protocol, max_speed_mps=CARRIED * robot.speed_mps)
        parts.append(replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v, charge=False) if counted else cut)
    return runs, driven_only(concatenate(parts))
