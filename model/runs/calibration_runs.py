"""What a calibration reads: new, baseline and test runs of one robot, as segments on their maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import CARRIED, Protocol, cut_segments
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.files import read_alike
from joulemap.model.runs.odometry import Odometry, flat_heightmap, read_odometry
from joulemap.model.runs.reader import Run, read_run
from joulemap.model.runs.rolling import cut_travel
from joulemap.model.runs.segments import Segments, concatenate_segments, driven_only
from joulemap.model.runs.sites import Site, files_of, robot_of_all
from joulemap.model.terrain.heightmap import Heightmap


@dataclass(frozen=True, eq=False, repr=False)
class SiteSegments:
    """The runs on one map, as segments.

    Attributes
    ----------
    heightmap : Heightmap
        The ground, in the frame of the segments.
    new : Segments, optional
        Of the runs to learn from: energy in J, or charge in A s where no run has a voltage.
    baseline : Segments, optional
        Of runs in which nothing new happens.
    test : Segments, optional
        Of runs that take no part in the fit and are only predicted.
    """

    heightmap: Heightmap
    new: Segments | None
    baseline: Segments | None = None
    test: Segments | None = None


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationRuns:
    """The runs that a calibration reads.

    Attributes
    ----------
    sites : tuple of SiteSegments
        The maps and the runs on each; on one of them there is a run to learn from.
    robot : Robot
        That drove all of them.
    rows : int
        Of all files.
    repairs : dict
        Counts by name of the run and rule.
    placed : bool
        Whether positions are places on a map. False where they are integrated from wheel speeds.
    """

    sites: tuple[SiteSegments, ...]
    robot: Robot
    rows: int
    repairs: dict[str, dict[str, int]]
    placed: bool = True

    @cached_property
    def segments(self) -> Segments:
        """Of all runs to learn from, in the order of the sites; places are in the frame of their own site."""
        return concatenate_segments([site.new for site in self.sites if site.new is not None])

    @property
    def run_count(self) -> int:
        """Number of runs to learn from and of test runs."""
        return sum(len(part.runs) for site in self.sites for part in (site.new, site.test) if part is not None)


def read_calibration_runs(
    sites: Sequence[Site], *, protocol: Protocol = "track", currents: Currents = "auto"
) -> CalibrationRuns:
    """Read runs with positions.

    Parameters
    ----------
    sites : sequence of Site
        Maps, the runs on each, and the robot: segments far above its speed are left out.
    protocol : {"track", "chords"}
        As in `cut_segments`.
    currents : {"auto", "signed", "magnitude"}
        How the currents of several motors are summed (`joulemap.model.runs.electric`).

    Returns
    -------
    CalibrationRuns
        Of all files. No two different files have the same name.

    Raises
    ------
    InputError
        If there is no site, if a run is given twice, or if the robots of the sites differ.
    RunsError
        If there is no run to learn from, if a file is no run, or if only some runs have a voltage.
    """
    learned = files_of(sites)
    robot = robot_of_all(sites)
    groups = [some for site in sites for some in (site.files, site.baseline_files, site.test_files)]
    readers = [
        partial(_read_placed, site.heightmap.frame.crs)
        for site in sites
        for _ in (*site.files, *site.baseline_files, *site.test_files)
    ]
    runs = _read(learned, groups, readers, currents)

    def _cut_one(run: Run, charge: bool) -> Segments:
        return cut_segments(run, charge=charge, protocol=protocol, max_speed_mps=CARRIED * robot.speed_mps)

    parts = iter(_cut(runs, _cut_one))
    read = tuple(SiteSegments(site.ground, *islice(parts, 3)) for site in sites)
    return CalibrationRuns(read, robot, *_counts(runs))


def read_odometry_runs(
    files: Sequence[Path],
    odometry: Odometry,
    robot: Robot,
    *,
    baseline_files: Sequence[Path] = (),
    test_files: Sequence[Path] = (),
    currents: Currents = "auto",
) -> CalibrationRuns:
    """Read runs without positions, whose wheel speeds are integrated, on level ground that covers all of them.

    Parameters
    ----------
    files : sequence of Path
        Of the runs to learn from.
    odometry : Odometry
        How wheel speeds become a track.
    robot : Robot
        That drove.
    baseline_files : sequence of Path
        Of runs in which nothing new happens.
    test_files : sequence of Path
        Of runs for the test only.
    currents : {"auto", "signed", "magnitude"}
        As in `read_calibration_runs`.

    Returns
    -------
    CalibrationRuns
        Of one site.

    Raises
    ------
    RunsError
        As `read_calibration_runs`.
    """
    groups = [files, baseline_files, test_files]
    readers = [partial(_read_wheels, odometry)] * sum(map(len, groups))
    runs = _read(files, groups, readers, currents)
    parts = _cut(runs, lambda run, charge: cut_travel(run, charge=charge))
    ground = flat_heightmap([run for some in runs for run in some])
    return CalibrationRuns((SiteSegments(ground, *parts),), robot, *_counts(runs), placed=False)


def _read_placed(crs: str | None, file: Path, name: str, currents: Currents) -> Run:
    return read_run(file, name=name, crs=crs, currents=currents)


def _read_wheels(odometry: Odometry, file: Path, name: str, currents: Currents) -> Run:
    return read_odometry(file, odometry, name=name, currents=currents)


def _read(
    learned: Sequence[Path],
    groups: Sequence[Sequence[Path]],
    readers: Sequence[Callable[[Path, str, Currents], Run]],
    currents: Currents,
) -> list[list[Run]]:
    """The runs of each group of files."""
    if not learned:
        raise RunsError("there is no run to read: no file has such a name")
    runs = iter(read_alike([file for some in groups for file in some], readers, currents))
    return [list(islice(runs, len(some))) for some in groups]


def _cut(runs: Sequence[Sequence[Run]], cut: Callable[[Run, bool], Segments]) -> list[Segments | None]:
    """The segments of each group of runs, None where there is no run."""
    every = [run for some in runs for run in some]
    without = [run.name for run in every if not run.has_energy]
    if without and len(without) < len(every):
        raise RunsError(
            f"{len(without)} of {len(every)} runs have no voltage (the first is {without[0]}): calibrate them "
            "separately",
            run=without[0],
        )
    return [
        driven_only(concatenate_segments([cut(run, bool(without)) for run in some])) if some else None for some in runs
    ]


def _counts(runs: Sequence[Sequence[Run]]) -> tuple[int, dict[str, dict[str, int]]]:
    every = [run for some in runs for run in some]
    return sum(len(run) for run in every), {run.name: run.repairs for run in every if run.repairs}
