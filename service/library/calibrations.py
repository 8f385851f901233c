"""Calibration for a Python user: what a model lacks on measured runs, as a report and a model that has it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from joulemap.service.exports.formats import format_of
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from joulemap.service.exports.track import track_of_drive
from joulemap.service.library.heightmaps import GroundLike, RobotLike
from joulemap.service.library.run_files import RunsLike
from joulemap.service.library.sites import SiteLike
from joulemap.service.models import CALIBRATED_FOLDER
from joulemap.service.places.coordinates import PlaceLike
from joulemap.service.questions.asking import asks
from joulemap.service.questions.calibrating import LocalCalibration, ask

Point = PlaceLike
"""World x, y [m] in the CRS of the map; or latitude, longitude, see `service.places.coordinates.world_point`."""
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
        chosen, track = format_of(ROUTE_FORMATS, file, format), track_of_drive(self.report["next_drive"])
        file.write_bytes(RouteFile(chosen, coordinates).written(track))
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


@asks(LocalCalibration)
def calibrate(
    ground: GroundLike | None = None,
    runs: RunsLike | None = None,
    *,
    out: str | Path,
    sites: Sequence[SiteLike] | None = None,
    campaign: str | Path | None = None,
    robot: RobotLike = None,
    baseline_runs: RunsLike | None = None,
    test_runs: RunsLike | None = None,
    wanted: LocalCalibration,
    progress: Callable[[float], None] | None = None,
) -> CalibrationResult:
    """Find what a model lacks on measured runs, and write a model that has it.

    Parameters
    ----------
    ground : Heightmap, str or Path, optional
        The heightmap that the runs were driven on. Not with `sites` or `campaign`. Runs with a speed or a distance and
        no positions need none.
    out : str or Path
        Folder for `report.json`, `report.html` and the calibrated model.
    sites : sequence of tuple, optional
        Several heightmaps and the runs on each: pairs (heightmap, runs). All are calibrated together.
    baseline_runs : Runs, str, Path or sequence of these, optional
        Runs beside `runs` in which nothing new is at work. By default those that the model was trained on. A campaign
        file names them with the key `baseline` of a site.
    test_runs : Runs, str, Path or sequence of these, optional
        Runs that have no part in the fit; the report has the error on them before and after. Of several sites, they are
        among the runs of one.

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
    from joulemap.model.runs.odometry import Odometry
    from joulemap.service.library.sites import read_compared
    from joulemap.service.loop.report_page import report_page

    read = read_compared(
        {"ground": ground, "runs": runs, "sites": sites, "campaign": campaign, "robot": robot},
        baseline_runs=baseline_runs,
        test_runs=test_runs,
        odometry=None if wanted.odometry_track_m is None else Odometry(wanted.odometry_track_m),
    )
    folder = Path(out)
    made = ask(wanted.model, read, wanted, out=folder, progress=progress)
    text = json.dumps(made.document, indent=2, allow_nan=False) + "\n"
    (folder / REPORT_JSON).write_text(text, encoding="utf-8")
    (folder / REPORT_HTML).write_text(report_page(made), encoding="utf-8")
    return CalibrationResult(folder, made.document)
