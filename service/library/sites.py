"""Several sites in one call: pairs of a heightmap and its runs, options of a command line, or a campaign file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from joulemap.model.errors import InputError, NotFoundError, nearest_name
from joulemap.model.runs.calibration_runs import CalibrationRuns, read_calibration_runs
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.sites import Site, with_test_files
from joulemap.model.runs.without_map import sites_without_map
from joulemap.service.library.heightmaps import GroundLike, RobotLike, ground_of, robot_of
from joulemap.service.library.run_files import RunsLike, find_run_files

SiteLike = Site | tuple[GroundLike, RunsLike] | tuple[GroundLike, RunsLike, RobotLike]
"""A heightmap, its runs and, where it is another one, the robot that drove there."""

_SITE_KEYS = ("heightmap", "runs", "robot", "baseline")


def sites_of(sites: Sequence[SiteLike], *, robot: RobotLike = None) -> list[Site]:
    """Return the sites that are meant. Raises NotFoundError if runs are not there."""
    usual = robot_of(robot)
    found = []
    for number, site in enumerate(sites, start=1):
        if isinstance(site, Site):
            found.append(site)
            continue
        if not isinstance(site, tuple | list) or len(site) not in (2, 3):
            raise InputError(
                f"site {number} is {str(site)[:60]!r}: give pairs of a heightmap and its runs, "
                "like sites=[('a.tif', 'a/*.csv'), ('b.tif', 'b.csv')]"
            )
        driver = robot_of(site[2]) if len(site) == 3 and site[2] is not None else usual
        found.append(Site(ground_of(site[0]), tuple(find_run_files(site[1])), driver))
    return found


def sites_given(
    ground: GroundLike | None = None,
    runs: RunsLike | None = None,
    *,
    sites: Sequence[SiteLike] | None = None,
    campaign: str | Path | None = None,
    robot: RobotLike = None,
) -> list[Site]:
    """Return the sites of a call that takes one heightmap with its runs, or several, or a campaign file."""
    ways = [ground is not None or runs is not None, sites is not None, campaign is not None]
    if sum(ways) != 1 or (ways[0] and runs is None):
        raise InputError("give a heightmap and its runs, or `sites`, or a `campaign` file")
    if campaign is not None:
        return read_campaign(campaign, robot=robot)
    if sites is not None:
        return sites_of(sites, robot=robot)
    assert runs is not None
    if ground is None:
        return sites_without_map(find_run_files(runs), robot_of(robot))
    return sites_of([(ground, runs)], robot=robot)


def read_compared(
    given: Mapping[str, Any],
    *,
    baseline_runs: RunsLike | None = None,
    test_runs: RunsLike | None = None,
    odometry: Odometry | None = None,
    currents: Currents = "auto",
) -> CalibrationRuns:
    """Read the runs of a calibration, on their maps or on the ground that their logs describe.

    `given`: the arguments of `sites_given`.
    """
    baseline, test = find_run_files(baseline_runs), find_run_files(test_runs)
    runs = given["runs"]
    if baseline and runs is None:
        raise InputError("`baseline_runs` go with `runs`; in a campaign file a site has the key `baseline`")
    if runs is not None and all(given[name] is None for name in ("ground", "sites", "campaign")):
        files, robot = find_run_files(runs), robot_of(given["robot"])
        sites = sites_without_map(files, robot, baseline_files=baseline, test_files=test, odometry=odometry)
    elif odometry is not None:
        raise InputError("`odometry_track_m` goes with `runs` without positions, which belong to no heightmap")
    else:
        sites = sites_given(**given)
        if baseline:
            sites = [replace(sites[0], baseline_files=tuple(baseline))]
        sites = with_test_files(sites, test)
    return read_calibration_runs(sites, currents=currents)


def sites_of_options(values: Sequence[str]) -> list[tuple[Path, list[str]]]:
    """Return heightmaps and runs of values like `dem.tif=runs/*.csv`.

    Raises NotFoundError if a heightmap is not there.
    """
    sites: list[tuple[Path, list[str]]] = []
    for value in values:
        ends = [k for k, letter in enumerate(value) if letter == "="]
        named = next((k for k in ends if Path(value[:k]).is_file()), None)
        if named is None and ends and not Path(value).exists():
            raise NotFoundError(f"there is no heightmap {value[: ends[0]]}", path=value[: ends[0]])
        if named is not None:
            sites.append((Path(value[:named]), [value[named + 1 :]] if value[named + 1 :] else []))
        elif sites:
            sites[-1][1].append(value)
        else:
            raise InputError(f"{value!r} is no site: write HEIGHTMAP=RUNS, like dem.tif=runs/*.csv", value=value)
    for heightmap, runs in sites:
        if not runs:
            raise InputError(f"the site {heightmap} has no runs: write HEIGHTMAP=RUNS, like {heightmap}=runs/*.csv")
    return sites


def read_campaign(path: str | Path, *, robot: RobotLike = None) -> list[Site]:
    """Read a campaign file: a TOML file with a table [[site]] for every map.

    A site has the keys `heightmap`, `runs` (a file, a pattern, or a list of them), `baseline` (likewise, the baseline
    runs of a calibration; such a site may lack `runs`) and, if another robot drove there, `robot`. The key `robot` at
    the top names the robot of all other sites. Paths are relative to the file.

    Raises NotFoundError if the file, or one that it names, is not there.
    """
    path = Path(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise NotFoundError(f"there is no campaign file {path}", path=str(path)) from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"campaign file {path} cannot be read: {error}", path=str(path)) from error
    tables = document.pop("site", [])
    usual = _robot_in(path, document.pop("robot", None), robot)
    if document or not isinstance(tables, list) or not tables:
        raise InputError(
            f"campaign file {path}: " + (_unknown(document, ("site", "robot")) if document else "it has no [[site]]"),
            path=str(path),
        )
    sites = []
    for number, table in enumerate(tables, start=1):
        needed = ("heightmap", "runs") if not table.get("baseline") else ("heightmap",)
        missing = [key for key in needed if not table.get(key)]
        other = {key: value for key, value in table.items() if key not in _SITE_KEYS}
        if missing or other:
            what = f"`{missing[0]}` is missing" if missing else _unknown(other, _SITE_KEYS)
            raise InputError(f"campaign file {path}, site {number}: {what}", path=str(path), site=number)
        runs, baseline = (_runs_in(path, table.get(key)) for key in ("runs", "baseline"))
        ground = ground_of(path.parent / str(table["heightmap"]))
        sites.append(Site(ground, runs, _robot_in(path, table.get("robot"), usual), baseline))
    return sites


def _runs_in(path: Path, named: Any) -> tuple[Path, ...]:
    runs = [named] if isinstance(named, str) else named or []
    return tuple(find_run_files([path.parent / str(run) for run in runs]))


def _robot_in(path: Path, named: Any, usual: RobotLike) -> Any:
    if named is None:
        return robot_of(usual)
    return robot_of(named if isinstance(named, dict) else path.parent / str(named))


def _unknown(values: dict[str, Any], known: Sequence[str]) -> str:
    name = next(iter(values))
    near = nearest_name(name, known)
    return f"{name}: unknown{f'; did you mean {near}?' if near else ''}; known are {', '.join(known)}"
