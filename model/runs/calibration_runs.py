"""What a calibration reads: new, baseline and test runs of one robot, as segments on their maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_placed
from joulemap.model.runs.cutting import CARRIED, cut_segments
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.files import read_alike
from joulemap.model.runs.reader import read_run
from joulemap.model.runs.rolling import cut_travel
from joulemap.model.runs.run import Run
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
        Whether positions are places on a map. False where they are integrated from wheel speeds or from a distance.
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


def read_calibration_runs(sites: Sequence[Site], *, currents: Currents = "auto") -> CalibrationRuns:
    """Read the runs of all sites. No two different files have the same name."""
    learned = files_of(sites)
    robot = robot_of_all(sites)
    groups = [some for site in sites for some in (site.files, site.baseline_files, site.test_files)]
    readers = [_reader(site) for site in sites for _ in (*site.files, *site.baseline_files, *site.test_files)]
    runs = _read(learned, groups, readers, currents)
    for site, some in zip((site for site in sites for _ in range(3)), runs, strict=True):
        check_placed(some if site.placed else ())
    parts = iter(_cut(runs, [_cutter(site) for site in sites for _ in range(3)]))
    read = tuple(SiteSegments(site.ground, *islice(parts, 3)) for site in sites)
    return CalibrationRuns(read, robot, *_counts(runs), placed=all(site.placed for site in sites))


def _reader(site: Site) -> Callable[[Path, str, Currents], Run]:
    crs, how = site.heightmap.frame.crs, site.odometry
    return lambda file, name, currents: read_run(file, name=name, crs=crs, odometry=how, currents=currents)


def _cutter(site: Site) -> Callable[[Run, bool], Segments]:
    if site.odometry is not None:
        return lambda run, charge: cut_travel(run, charge=charge)
    fastest = CARRIED * site.robot.speed_mps
    return lambda run, charge: cut_segments(run, length_m=site.length_m, charge=charge, max_speed_mps=fastest)


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


def _cut(runs: Sequence[Sequence[Run]], cutters: Sequence[Callable[[Run, bool], Segments]]) -> list[Segments | None]:
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
        driven_only(concatenate_segments([cut(run, bool(without)) for run in some])) if some else None
        for some, cut in zip(runs, cutters, strict=True)
    ]


def _counts(runs: Sequence[Sequence[Run]]) -> tuple[int, dict[str, dict[str, int]]]:
    every = [run for some in runs for run in some]
    return sum(len(run) for run in every), {run.name: run.repairs for run in every if run.repairs}
