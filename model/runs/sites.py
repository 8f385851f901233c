"""Sites: maps, the runs that were driven on each of them, and the robot that drove there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_place, check_placed, check_units
from joulemap.model.runs.files import distinct_names, read_segments, same_content
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.run import Run
from joulemap.model.runs.segments import Segments, concatenate_segments
from joulemap.model.terrain.heightmap import Heightmap


@dataclass(frozen=True, eq=False)
class Site:
    """A map and the runs on it.

    Attributes
    ----------
    heightmap : Heightmap
        The ground, in the frame of the runs.
    files : tuple of Path
        The runs to learn from.
    robot : Robot
        That drove here. Robots of several sites may differ in size, except for a calibration.
    baseline_files : tuple of Path
        Runs in which nothing new happens, for a calibration.
    test_files : tuple of Path
        Runs that a calibration only predicts.
    placed : bool
        Whether it is a map. False for the ground that the log of a run without positions describes
        (`joulemap.model.runs.without_map`).
    odometry : Odometry, optional
        How wheel speeds become a track, of such a run.
    length_m : float, optional
        Nominal length of segments [m], as in `cut_segments`.
    """

    heightmap: Heightmap
    files: tuple[Path, ...]
    robot: Robot
    baseline_files: tuple[Path, ...] = ()
    test_files: tuple[Path, ...] = ()
    placed: bool = True
    odometry: Odometry | None = None
    length_m: float | None = None

    @property
    def ground(self) -> Heightmap:
        """What the robot drove on, as the survey lets it be known."""
        return self.heightmap.without_noise


@dataclass(frozen=True, eq=False)
class SiteRuns:
    """The runs of several sites, cut into segments.

    Attributes
    ----------
    sites : tuple of Site
        In the order in which they were given.
    runs : tuple of Run
        Of all sites, each with a name that no other has.
    segments : Segments
        Of all runs; places are in the frame of their own site.
    site : ndarray of int, (n,)
        Site of each segment.
    """

    sites: tuple[Site, ...]
    runs: tuple[Run, ...]
    segments: Segments
    site: NDArray[np.int64]

    def on(self, number: int) -> NDArray[np.int64]:
        """Return which segments lie on a site."""
        return np.flatnonzero(self.site == number)


def files_of(sites: Sequence[Site]) -> list[Path]:
    """Return the runs to learn from, and check that each lies on one map."""
    if not sites:
        raise InputError("there is no site: give a heightmap and its runs")
    files = [file for site in sites for file in site.files]
    places = [file.resolve() for file in files]
    twice = next((file for k, file in enumerate(files) if places[k] in places[:k]), None)
    if twice is not None:
        raise InputError(f"the run {twice} is given twice: a run belongs to one map", run=str(twice))
    baseline = [file for site in sites for file in site.baseline_files]
    copies = same_content([*files, *(file for file in baseline if file not in files)])
    both = next((file for file in baseline if file.resolve() in places or copies.get(file) in files), None)
    if both is not None:
        raise InputError(
            f"{both.name} is a run to learn from and a baseline run: nothing is new in a run beside itself. Name "
            "earlier runs as baseline",
            run=str(both),
        )
    return files


def with_test_files(sites: Sequence[Site], files: Sequence[Path]) -> list[Site]:
    """Take test runs out of their sites' other runs."""
    tests = {file.resolve(): file for file in files}

    def _others(some: tuple[Path, ...]) -> tuple[Path, ...]:
        return tuple(file for file in some if file.resolve() not in tests)

    out = []
    for site in sites:
        own = {file.resolve() for file in (*site.files, *site.baseline_files)} if len(sites) > 1 else set(tests)
        mine = tuple(file for place, file in tests.items() if place in own)
        out.append(
            replace(site, files=_others(site.files), baseline_files=_others(site.baseline_files), test_files=mine)
        )
    placed = {file.resolve() for site in out for file in site.test_files}
    lost = next((file for place, file in tests.items() if place not in placed), None)
    if lost is not None:
        raise InputError(f"the test run {lost} is on no site: name it among the runs of its map too", run=str(lost))
    return out


def robot_of_all(sites: Sequence[Site]) -> Robot:
    """Return the one robot that drove on all sites."""
    first = sites[0]
    for site in sites[1:]:
        if site.robot != first.robot:
            raise InputError(
                f"the robot of the site {site.heightmap.source} ({site.robot.name}) is not declared like that of the "
                f"site {first.heightmap.source} ({first.robot.name}): effects are those of one robot. Calibrate the "
                "runs of each robot separately, or give all sites the same robot file",
                heightmap=site.heightmap.source,
            )
    return first.robot


def read_sites(sites: Sequence[Site], *, charge: bool = False) -> SiteRuns:
    """Read the runs of several sites, and check that each was driven on its map."""
    files = files_of(sites)
    idle = next((site for site in sites if not site.files), None)
    if idle is not None:
        raise InputError(
            f"the site {idle.heightmap.source} has no `runs` to learn from", heightmap=idle.heightmap.source
        )
    names = iter(distinct_names(files))
    runs: list[Run] = []
    parts: list[Segments] = []
    for site in sites:
        mine = [next(names) for _ in site.files]
        try:
            found, segments = read_segments(
                site.files, site.robot, crs=site.heightmap.frame.crs, charge=charge, length_m=site.length_m
            )
            segments = replace(segments, runs=tuple(mine))
            check_placed(found if site.placed else ())
            check_place(segments, site.heightmap)
        except RunsError as error:
            if len(sites) == 1:
                raise
            raise RunsError(f"{error.message} (site {site.heightmap.source})", **error.context) from error
        runs += [replace(run, name=name) for run, name in zip(found, mine, strict=True)]
        parts.append(segments)
    check_units([(part, site.robot) for part, site in zip(parts, sites, strict=True)])
    number = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return SiteRuns(tuple(sites), tuple(runs), concatenate_segments(parts), number)
