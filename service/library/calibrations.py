"""Calibration for a Python user: what a model lacks on measured runs, as a report and a model that has it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import InputError
from joulemap.service.coordinates import PlaceLike
from joulemap.service.exports.routes import route_file, route_format_of
from joulemap.service.exports.track import track_of_drive
from joulemap.service.library.heightmaps import GroundLike, RobotLike, robot_of
from joulemap.service.library.models import ModelLike, model_folder
from joulemap.service.library.run_files import RunsLike, find_run_files
from joulemap.service.library.sites import SiteLike, sites_given
from joulemap.service.models import CALIBRATED_FOLDER, DEFAULT_MODEL

if TYPE_CHECKING:
    from joulemap.model.runs.calibration_runs import CalibrationRuns
    from joulemap.service.loop.rerouting import AskedTask

Point = PlaceLike
"""World x, y [m] in the CRS of the map; or latitude, longitude, see `joulemap.service.coordinates.world_point`."""
REPORT_JSON, REPORT_HTML = "report.json", "report.html"
"""What `calibrate` writes beside the calibrated model."""


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """What a model lacks on measured runs. It may be given wherever a model is asked for.

    Attributes
    ----------
    out : Path
        Folder of `report.json`, `report.html` and the calibrated model.
    report : dict
        The report, as in `report.json`.
    """

    out: Path
    report: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Folder of the calibrated model."""
        return self.out / CALIBRATED_FOLDER

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was found, each with name, coefficients, 95 % intervals and p-value; in the order found."""
        return list(self.report["effects"])

    @property
    def warnings(self) -> list[str]:
        """How the map or the robot differs from what the model was trained on."""
        return list(self.report["warnings"])

    @property
    def report_html(self) -> Path:
        """The report for a browser."""
        return self.out / REPORT_HTML

    def save_next_drive(self, path: str | Path, *, format: str | None = None, coordinates: str | None = None) -> Path:
        """Write what to drive next for another program, as `PlannedRoute.save` writes a route.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.
        format : str, optional
            By default the suffix decides.
        coordinates : str, optional
            Of GeoJSON, "wgs84" or "map".

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If no drive is suggested, its corners are no places of a map, or the format does not go with the map.
        """
        file = Path(path)
        chosen, track = route_format_of(file, format), track_of_drive(self.report["next_drive"])
        file.write_bytes(route_file(track, chosen, coordinates=coordinates))
        return file

    def _lines(self) -> list[str]:
        from joulemap.service.loop.summary import summary_lines

        warnings = [f"Warning: {words}" for words in self.warnings]
        return [*summary_lines(self.report), *warnings, f"Report: {self.report_html}"]

    def __repr__(self) -> str:
        from joulemap.service.loop.summary import headline

        return f"<Calibration: {headline(self.report)}>"

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _repr_html_(self) -> str:
        title, *lines = self._lines()
        return (
            f"<div><strong>{escape(title)}</strong>{''.join(f'<p>{escape(line.strip())}</p>' for line in lines)}</div>"
        )


def calibrate(
    ground: GroundLike | None = None,
    runs: RunsLike | None = None,
    *,
    out: str | Path,
    sites: Sequence[SiteLike] | None = None,
    campaign: str | Path | None = None,
    model: ModelLike = DEFAULT_MODEL,
    robot: RobotLike = None,
    baseline_runs: RunsLike | None = None,
    test_runs: RunsLike | None = None,
    odometry_track_m: float | None = None,
    start: Point | None = None,
    goal: Point | None = None,
    campaigns: bool = False,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> CalibrationResult:
    """Find what a model lacks on measured runs, and write a model that has it.

    Parameters
    ----------
    ground : Heightmap, str or Path, optional
        The heightmap that the runs were driven on. Not with `sites` or `campaign`. Runs with a speed or a distance and
        no positions need none.
    runs : Runs, str, Path or sequence of these, optional
        The runs, or their files.
    out : str or Path
        Folder for `report.json`, `report.html` and the calibrated model.
    sites : sequence of tuple, optional
        Several heightmaps and the runs on each: pairs (heightmap, runs). All are calibrated together.
    campaign : str or Path, optional
        A TOML file with a table [[site]] for every map.
    model : str, Path or Model, optional
        The model to be calibrated.
    robot : Robot, mapping, str, Path or None, optional
        The robot that drove.
    baseline_runs : Runs, str, Path or sequence of these, optional
        Runs beside `runs` in which nothing new is at work. By default those that the model was trained on. A campaign
        file names them with the key `baseline` of a site.
    test_runs : Runs, str, Path or sequence of these, optional
        Runs that have no part in the fit; the report has the error on them before and after. Of several sites, they are
        among the runs of one.
    odometry_track_m : float, optional
        Effective track width [m]: the runs have no positions, and the wheel speeds of both sides are integrated.
    start, goal : sequence of float, optional
        World x, y [m] of a task whose routes before and after are compared, on the map with the most metres driven.
    campaigns : bool, optional
        For the errors, leave out whole campaigns instead of single runs. Runs of one campaign have the same date in
        their name, or the same name before the last underscore, such as `2018-11_00` and `2018-11_01`.
    quick : bool, optional
        Calibrate once, without repeating everything on parts of the runs: the errors are then those of the fit, which
        are too small.
    seed : int, optional
        Of the places that are tried for the route and the next drive.
    progress : callable, optional
        Called with the share done, 0..1.

    Returns
    -------
    CalibrationResult
        Effects, errors before and after, and the calibrated model.

    Raises
    ------
    RunsError
        If the runs cannot be used.
    ConflictError
        If `out` holds a calibrated model already: a model version is never changed.
    InputError
        If only one of `start` and `goal` is given, if the sites are none or have several robots, or if all runs belong
        to one campaign.
    """
    from joulemap.model.runs.calibration_runs import read_calibration_runs
    from joulemap.model.runs.odometry import Odometry
    from joulemap.model.runs.sites import with_test_files
    from joulemap.model.runs.without_map import sites_without_map

    if (start is None) != (goal is None):
        raise InputError("give `start` and `goal`, or neither")
    baseline, test = find_run_files(baseline_runs), find_run_files(test_runs)
    if baseline and runs is None:
        raise InputError("`baseline_runs` go with `runs`; in a campaign file a site has the key `baseline`")
    if ground is None and runs is not None and sites is None and campaign is None:
        how = None if odometry_track_m is None else Odometry(odometry_track_m)
        files, driver = find_run_files(runs), robot_of(robot)
        given = sites_without_map(files, driver, baseline_files=baseline, test_files=test, odometry=how)
    elif odometry_track_m is not None:
        raise InputError("`odometry_track_m` goes with `runs` without positions, which belong to no heightmap")
    else:
        given = sites_given(ground, runs, sites=sites, campaign=campaign, robot=robot)
        if baseline:
            given = [replace(given[0], baseline_files=tuple(baseline))]
        given = with_test_files(given, test)
    read = read_calibration_runs(given)
    task = None if start is None or goal is None else (start, goal)
    return calibrate_and_report(
        model_folder(model),
        read,
        out=Path(out),
        task=task,
        campaigns=campaigns,
        quick=quick,
        seed=seed,
        progress=progress,
    )


def calibrate_and_report(
    model: str | Path,
    runs: CalibrationRuns,
    *,
    out: Path,
    task: AskedTask | None = None,
    campaigns: bool = False,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> CalibrationResult:
    """Calibrate on runs that are read already, and write the report beside the model."""
    from joulemap.service.loop.calibration import calibrate_on_runs, campaigns_of
    from joulemap.service.loop.report_page import report_page

    made = calibrate_on_runs(
        model,
        runs,
        out=out,
        task=task,
        groups=campaigns_of(runs.segments.runs) if campaigns else None,
        cross_validate=not quick,
        seed=seed,
        progress=progress,
    )
    text = json.dumps(made.document, indent=2, allow_nan=False) + "\n"
    (out / REPORT_JSON).write_text(text, encoding="utf-8")
    (out / REPORT_HTML).write_text(report_page(made), encoding="utf-8")
    return CalibrationResult(out, made.document)
