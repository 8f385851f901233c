"""`joulemap calibrate` and `suggest-drive`: what measured runs show that a model lacks, and what to drive next."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.cluster import AsOneTask
from joulemap.service.commands.console import JsonFile, Output, json_text, parse_point, progress_bar, write_file
from joulemap.service.commands.options import (
    BaselineRuns,
    Campaign,
    MaybeHeightmap,
    MaybeRuns,
    ModelName,
    Reading,
    RobotFile,
    Sites,
    find_runs,
    named_sites,
    reading_words,
    robot_of,
    robot_words,
)
from joulemap.service.commands.route_files import RouteCoordinates, RouteFiles, RouteFormatName, wanted_files
from joulemap.service.words import energy_words, runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.calibration_runs import CalibrationRuns
    from joulemap.model.runs.electric import Currents
    from joulemap.service.loop.next_words import NextStep

_CORNERS = 8  # of a route

OdometryTrack = Annotated[
    float | None,
    typer.Option(
        "--odometry",
        metavar="TRACK",
        help="The runs have wheel speeds of both sides and no positions: integrate `speed_left` and `speed_right` on "
        "level ground, with this effective track width [m].",
    ),
]
TerrainFromName = Annotated[
    bool, typer.Option("--terrain-from-name", help="With `--odometry`: the file snow_02.csv was driven on snow.")
]


def _currents(text: str) -> str:
    ways = ("auto", "signed", "magnitude")
    if text not in ways:
        raise typer.BadParameter(f"{text!r} is none of {', '.join(ways)}")
    return text


SumOfCurrents = Annotated[
    Any,
    typer.Option(
        "--currents",
        parser=_currents,
        metavar="auto|signed|magnitude",
        help="How the currents of several motors are summed: with their sign, without it, or as the log tells.",
    ),
]


def calibrate(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    runs: MaybeRuns = None,
    heightmap: MaybeHeightmap = None,
    site: Sites = None,
    campaign: Campaign = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    baseline_runs: BaselineRuns = None,
    test_runs: Annotated[
        list[str] | None,
        typer.Option(
            "--test-runs",
            metavar="FILE...",
            help="Runs (also some of `--runs`) that are not used to find or fit effects: the report has the error on "
            "them before and after. With `--site` and `--campaign`: some of their runs.",
        ),
    ] = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    currents: SumOfCurrents = "auto",
    start: Annotated[
        Any,
        typer.Option(
            metavar="X,Y",
            parser=parse_point,
            help="Start of the route that is compared before and after [m], on the map with the most metres driven.",
        ),
    ] = None,
    goal: Annotated[
        Any,
        typer.Option(
            metavar="X,Y", parser=parse_point, help="Its goal. [default: a few routes between places of the runs]"
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of the places that are tried for the route and the next drive.")
    ] = 0,
    campaigns: Annotated[
        bool,
        typer.Option(
            "--campaigns",
            help="For the errors, leave out whole campaigns instead of single runs. Runs of one campaign have the same "
            "date in their name, or the same name before the last underscore: 2018-11_00 and 2018-11_01.",
        ),
    ] = False,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Calibrate once, without repeating everything on parts of the runs: the errors are then those of the "
            "fit, which are too small.",
        ),
    ] = False,
    scheduler: AsOneTask = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Find what a **model lacks on measured runs**, name it, and write a calibrated model.

    Examples:

    `joulemap calibrate --model mine --heightmap dem.tif --robot robot.toml --runs new/*.csv --out found`

    `joulemap calibrate --model mine --site a.tif=a/*.csv --site b.tif=b.csv --robot robot.toml --out found` (several
    maps, one robot)

    `joulemap calibrate --model physics --robot car.toml --runs drives --out found` (logs with a speed or a distance and
    no positions; the heights are those of the log)
    """
    from joulemap.service.loop.calibration import calibrate_on_runs, campaigns_of
    from joulemap.service.loop.report_page import report_page

    if (start is None) != (goal is None):
        raise typer.BadParameter("--start and --goal go together")
    output, began = Output(json_file), time.perf_counter()
    asked = _Asked(
        model,
        runs,
        heightmap,
        site,
        campaign,
        robot,
        baseline_runs,
        odometry,
        terrain_from_name,
        currents,
        reading,
    )
    read = asked.read(test_runs)
    with progress_bar("Calibrating") as report:
        made = calibrate_on_runs(
            model,
            read,
            out=out,
            task=None if start is None else (start, goal),
            groups=campaigns_of(read.segments.runs) if campaigns else None,
            cross_validate=not quick,
            seed=seed,
            progress=report,
        )
    steps = _next_steps(made.document, out, asked, read.robot)
    write_file(out / "report.json", json_text(made.document).encode())
    write_file(out / "report.html", report_page(made, steps=steps).encode())
    _say(output, made.document, out, steps)
    output.say(robot_words([read.robot]), head="Robot")
    output.say(
        f"{runs_words(read.run_count)}, {read.rows:,} rows, {made.document['segments']['fit']:,} segments in "
        f"{time.perf_counter() - began:.0f} s"
    )
    output.warn(made.document["warnings"])
    output.document(made.document)


@dataclass(frozen=True)
class _Asked:
    """What both commands are asked to look at: the model, the runs and the ground, as the options name them."""

    model: str
    runs: list[str] | None
    heightmap: Path | None
    site: list[str] | None
    campaign: Path | None
    robot: Path | None
    baseline_runs: list[str] | None
    odometry: float | None
    terrain_from_name: bool
    currents: Currents
    reading: Reading

    def __post_init__(self) -> None:
        ways = (self.heightmap is not None, bool(self.site), self.campaign is not None)
        if sum(ways) > 1:
            raise typer.BadParameter("give one of --heightmap, --site and --campaign")
        if not any(ways) and not self.runs:
            raise typer.BadParameter(
                "give --runs, and the map that they were driven on with --heightmap; or --site, or --campaign. Runs "
                "with a speed or a distance and no positions need no map"
            )
        if self.odometry is not None and any(ways):
            raise typer.BadParameter("--odometry is for runs without positions, which lie on no map: give --runs alone")
        if self.terrain_from_name and self.odometry is None:
            raise typer.BadParameter("--terrain-from-name goes with --odometry")
        if self.baseline_runs and (self.site or self.campaign):
            raise typer.BadParameter(
                "--baseline-runs goes with --runs; in a campaign file a site has the key `baseline`"
            )

    def read(self, test_runs: list[str] | None = None) -> CalibrationRuns:
        """The runs, on their maps or on the ground that their logs describe."""
        from joulemap.model.runs.calibration_runs import read_calibration_runs
        from joulemap.model.runs.odometry import Odometry
        from joulemap.model.runs.sites import with_test_files
        from joulemap.model.runs.without_map import sites_without_map

        baseline, test = find_runs(self.baseline_runs or []), find_runs(test_runs or [])
        if self.heightmap is None and not self.site and self.campaign is None:
            how = None if self.odometry is None else Odometry(self.odometry, self.terrain_from_name)
            files, robot = find_runs(self.runs or []), robot_of(self.robot)
            sites = sites_without_map(files, robot, baseline_files=baseline, test_files=test, odometry=how)
        else:
            sites = named_sites(self.heightmap, self.runs, self.site, self.campaign, self.robot, self.reading)
            if baseline:
                sites = [replace(sites[0], baseline_files=tuple(baseline))]
            sites = with_test_files(sites, test)
        return read_calibration_runs(sites, currents=self.currents)

    def words(self) -> list[str]:
        """The options again, as they are typed."""
        words = ["--model", self.model]
        for name, value in (
            ("--heightmap", self.heightmap),
            ("--campaign", self.campaign),
            ("--odometry", self.odometry),
            ("--robot", self.robot),
        ):
            words += [] if value is None else [name, str(value)]
        words += ["--terrain-from-name"] * self.terrain_from_name + reading_words(self.reading)
        for name, values in (("--site", self.site), ("--runs", self.runs), ("--baseline-runs", self.baseline_runs)):
            words += [name, *values] if values else []
        return words if self.currents == "auto" else [*words, "--currents", self.currents]

    def ground_words(self, document: Mapping[str, Any], robot: Robot) -> list[str]:
        """The map that the report's route is on and the robot, as a cost map needs them."""
        from joulemap.model.robot import Robot as Declared
        from joulemap.service.library.sites import sites_of_options

        number = next(k for k, site in enumerate(document["sites"]) if site["main"])
        ground, usual = self.heightmap, self.robot
        if self.site:
            ground = sites_of_options(self.site)[number][0]
        elif self.campaign is not None:
            beside = self.campaign.parent / document["sites"][number]["heightmap"]
            ground = beside if beside.is_file() else None
            usual = usual or (None if robot == Declared() else Path("ROBOT"))
        words = [str(ground or "HEIGHTMAP"), *([] if self.campaign or ground is None else reading_words(self.reading))]
        return words if usual is None else [*words, "--robot", str(usual)]


def _next_steps(document: Mapping[str, Any], out: Path, asked: _Asked, robot: Robot) -> list[NextStep]:
    """What to type after a calibration."""
    from joulemap.service.loop.error_words import advice
    from joulemap.service.loop.next_words import NextStep, likeliest

    steps = [] if advice(document) else _plan_with(document, out, asked, robot)
    words = ["joulemap", "suggest-drive", *asked.words()]
    if document["effects"]:
        steps.append(NextStep("Get the drive that would make the answer more certain", shlex.join(words)))
    elif names := likeliest(document):
        effect = names[0][0]
        purpose = f"Get a drive that would show whether there is an effect of {effect}"
        steps.append(NextStep(purpose, shlex.join([*words, "--effect", effect])))
    return steps


def _plan_with(document: Mapping[str, Any], out: Path, asked: _Asked, robot: Robot) -> list[NextStep]:
    """What to type to plan with the calibrated model."""
    from joulemap.service.loop.next_words import NextStep

    made = out.with_name("after.zarr")
    words = ["joulemap", "costmap", *asked.ground_words(document, robot), "--model", str(out / "model")]
    words += ["--out", str(made)]
    steps = [NextStep("Make a cost map with the calibrated model", shlex.join(words))]
    task = document["route"].get("task", {"start": None, "goal": None})
    ends = (task[end] and f"{task[end][0]:.1f},{task[end][1]:.1f}" for end in ("start", "goal"))
    start, goal = (place or "X,Y" for place in ends)
    words = ["joulemap", "path", str(made), "--start", start, "--goal", goal]
    return [*steps, NextStep("Plan a path on it", shlex.join(words))]


def _say(output: Output, document: dict[str, Any], out: Path, steps: Sequence[NextStep]) -> None:
    from joulemap.model.runs.segments import coverage_words
    from joulemap.model.runs.words import count_words
    from joulemap.service.loop.next_words import drive_words
    from joulemap.service.loop.summary import summary_lines

    title, *lines = summary_lines(document)
    output.say(head=title)
    for line in lines:
        output.say(line)
    for step in steps:
        output.say(f"{step.purpose}:")
        output.say(head=f"  {step.command}")
    rows = {
        "track used": coverage_words(document["runs"]["coverage"]),
        "a route": _route_words(document["route"]),
        "drive next": drive_words(document["next_drive"]),
    }
    if left_out := count_words(document["runs"]["left_out"]):
        rows["not used"] = left_out
    output.table(rows)
    output.say(f"Written to {out}: report.json, report.html, model/")


def _route_words(route: Mapping[str, Any]) -> str:
    if "why_not" in route:
        return f"not compared: {route['why_not']}"
    (x0, y0), (x1, y1) = route["task"]["start"], route["task"]["goal"]
    old, new = (energy_words(route[key]["energy_j"]) for key in ("before", "after"))
    volts = f"; charge times {route['nominal_voltage_v']:g} V" if "nominal_voltage_v" in route else ""
    return (
        f"{x0:.1f},{y0:.1f} to {x1:.1f},{y1:.1f} ({route['task']['chosen']}): by the calibrated model, {old} as "
        f"planned before and {new} as planned after, {route['saving_percent']:.1f} % less{volts}"
    )


def _pace(drive: Mapping[str, Any]) -> str:
    return " and ".join(f"{v:.2f} m/s" for v in drive["speeds_mps"])


def suggest_drive(
    runs: MaybeRuns = None,
    heightmap: MaybeHeightmap = None,
    site: Sites = None,
    campaign: Campaign = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    effect: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Effect to find out about. [default: a confounded one, else the least certain]"
        ),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About how far to drive in all [m].")] = 200.0,
    out: RouteFiles = None,
    format: RouteFormatName = None,
    coordinates: RouteCoordinates = None,
    baseline_runs: BaselineRuns = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    currents: SumOfCurrents = "auto",
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Suggest **what to drive next**: the route that best separates confounded effects or narrows a coefficient.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --runs new/*.csv --out drive.plan`
    """
    from joulemap.service.exports.track import track_of_drive
    from joulemap.service.loop.deprecated_keys import with_former_keys
    from joulemap.service.loop.next_drive import suggest_next_drive
    from joulemap.service.loop.next_words import drive_words

    output, files = Output(json_file), wanted_files(out, format, coordinates)
    asked = _Asked(
        model,
        runs,
        heightmap,
        site,
        campaign,
        robot,
        baseline_runs,
        odometry,
        terrain_from_name,
        currents,
        reading,
    )
    read = asked.read()
    with progress_bar("Calibrating") as report:
        found = suggest_next_drive(model, read, effect=effect, length_m=length, progress=report).as_dict()
    output.say(drive_words(found))
    corners = found["points"][:: max(1, len(found["points"]) // _CORNERS)]
    output.table(
        {
            "corners": " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
            + ("" if found["placed"] else ", with 0,0 wherever there is room"),
            "one round": f"{found['length_m']:.0f} m, repeated for {length:.0f} m, at {_pace(found)}",
        }
    )
    for file in files:
        write_file(file.path, file.content(track_of_drive(found)))
    output.document(with_former_keys(found))
