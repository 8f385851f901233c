"""`joulemap calibrate` and `suggest-drive`: what measured runs show that a model lacks, and what to drive next."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from joulemap.service.commands.console import JsonFile, Output, json_text, parse_point, progress_bar, write_file
from joulemap.service.commands.options import (
    BaselineRuns,
    MaybeHeightmap,
    ModelName,
    Reading,
    RobotFile,
    Runs,
    find_runs,
    reading_words,
    reads_heightmap,
    robot_of,
)
from joulemap.service.words import energy_words, runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.electric import Currents
    from joulemap.model.runs.files import CalibrationRuns
    from joulemap.model.terrain.heightmap import Heightmap
    from joulemap.service.loop.summary import NextStep

_CORNERS = 8  # of a route

OdometryTrack = Annotated[
    float | None,
    typer.Option(
        "--odometry",
        metavar="TRACK",
        help="The runs have no positions: integrate `speed_left` and `speed_right` on level ground (no `--heightmap`), "
        "with this effective track width [m].",
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


@reads_heightmap
def calibrate(
    runs: Runs,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    heightmap: MaybeHeightmap = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    baseline_runs: BaselineRuns = None,
    test_runs: Annotated[
        list[str] | None,
        typer.Option(
            "--test-runs",
            metavar="FILE...",
            help="Runs (also some of `--runs`) that are not used to find or fit effects: the report has the error on "
            "them before and after.",
        ),
    ] = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    currents: SumOfCurrents = "auto",
    start: Annotated[
        Any,
        typer.Option(
            metavar="X,Y", parser=parse_point, help="Start of the route that is compared before and after [m]."
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
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Find what a **model lacks on measured runs**, name it, and write a calibrated model.

    Example: `joulemap calibrate --model mine --heightmap dem.tif --robot robot.toml --runs new/*.csv --out found`
    """
    from joulemap.service.loop.calibration import calibrate_on_runs, campaigns_of
    from joulemap.service.loop.report_page import report_page

    if (start is None) != (goal is None):
        raise typer.BadParameter("--start and --goal go together")
    output, began, driven_by = Output(json_file), time.perf_counter(), robot_of(robot)
    read, ground = _read(
        runs,
        baseline_runs,
        heightmap,
        driven_by,
        odometry,
        terrain_from_name,
        reading,
        test_runs=test_runs,
        currents=currents,
    )
    with progress_bar("Calibrating") as report:
        made = calibrate_on_runs(
            model,
            ground,
            driven_by,
            read,
            out=out,
            task=None if start is None else (start, goal),
            groups=campaigns_of(read.segments.runs) if campaigns else None,
            cross_validate=not quick,
            seed=seed,
            progress=report,
        )
    asked = _options(model, heightmap, robot, runs, baseline_runs, odometry, terrain_from_name, reading)
    asked += [] if currents == "auto" else ["--currents", currents]
    steps = _next_steps(made.document, out, heightmap, robot, reading, asked)
    write_file(out / "report.json", json_text(made.document).encode())
    write_file(out / "report.html", report_page(made, ground, steps=steps).encode())
    _say(output, made.document, out, steps)
    count = len(read.segments.runs) + (0 if read.test is None else len(read.test.runs))
    output.say(
        f"{runs_words(count)}, {read.rows:,} rows, {made.document['segments']['fit']:,} segments in "
        f"{time.perf_counter() - began:.0f} s"
    )
    output.warn(made.document["warnings"])
    output.document(made.document)


def _read(
    runs: list[str],
    baseline_runs: list[str] | None,
    heightmap: Path | None,
    robot: Robot,
    odometry: float | None,
    terrain_from_name: bool,
    reading: Reading,
    *,
    test_runs: list[str] | None = None,
    currents: Currents = "auto",
) -> tuple[CalibrationRuns, Heightmap]:
    """The runs that the options name, and the map or level ground that they were driven on."""
    from joulemap.model.runs.files import read_calibration_runs, read_odometry_runs
    from joulemap.model.runs.odometry import Odometry
    from joulemap.model.terrain.readers import read_heightmap

    if (heightmap is None) == (odometry is None):
        raise typer.BadParameter("give either --heightmap, or --odometry for runs without positions")
    if terrain_from_name and odometry is None:
        raise typer.BadParameter("--terrain-from-name goes with --odometry")
    test = find_runs(test_runs or [])
    test_files = {file.resolve() for file in test}
    files = [file for file in find_runs(runs) if file.resolve() not in test_files]
    more: dict[str, Any] = {"baseline_files": find_runs(baseline_runs or []), "test_files": test, "currents": currents}
    if odometry is not None:
        return read_odometry_runs(files, Odometry(odometry, terrain_from_name), **more)
    assert heightmap is not None
    ground = read_heightmap(heightmap, **reading)
    return read_calibration_runs(files, robot, crs=ground.frame.crs, **more), ground


def _options(
    model: str,
    heightmap: Path | None,
    robot: Path | None,
    runs: Sequence[str],
    baseline_runs: Sequence[str] | None,
    odometry: float | None,
    terrain_from_name: bool,
    reading: Reading,
) -> list[str]:
    """What `suggest-drive` needs to look at the same runs."""
    words = ["--model", model]
    for name, value in (("--heightmap", heightmap), ("--odometry", odometry), ("--robot", robot)):
        words += [] if value is None else [name, str(value)]
    words += ["--terrain-from-name"] * terrain_from_name + reading_words(reading) + ["--runs", *runs]
    return words + (["--baseline-runs", *baseline_runs] if baseline_runs else [])


def _next_steps(
    document: Mapping[str, Any],
    out: Path,
    heightmap: Path | None,
    robot: Path | None,
    reading: Reading,
    asked: Sequence[str],
) -> list[NextStep]:
    """What to type after a calibration."""
    from joulemap.service.loop.summary import NextStep, likeliest

    words = ["joulemap", "costmap", str(heightmap or "HEIGHTMAP"), *(reading_words(reading) if heightmap else [])]
    words += ["--robot", str(robot)] if robot is not None else []
    made = out.with_name("after.zarr")
    words += ["--model", str(out / "model"), "--out", str(made)]
    steps = [NextStep("Make a cost map with the calibrated model", shlex.join(words))]
    task = document["route"].get("task", {"start": None, "goal": None})
    ends = (task[end] and f"{task[end][0]:.1f},{task[end][1]:.1f}" for end in ("start", "goal"))
    start, goal = (place or "X,Y" for place in ends)
    words = ["joulemap", "path", str(made), "--start", start, "--goal", goal]
    steps.append(NextStep("Plan a path on it", shlex.join(words)))
    words = ["joulemap", "suggest-drive", *asked]
    if document["effects"]:
        steps.append(NextStep("Get the drive that would make the answer more certain", shlex.join(words)))
    elif names := likeliest(document):
        effect = names[0][0]
        purpose = f"Get a drive that would show whether there is an effect of {effect}"
        steps.append(NextStep(purpose, shlex.join([*words, "--effect", effect])))
    return steps


def _say(output: Output, document: dict[str, Any], out: Path, steps: Sequence[NextStep]) -> None:
    from joulemap.model.loop.words import left_out_words
    from joulemap.model.runs.segments import coverage_words
    from joulemap.service.loop.summary import drive_words, summary_lines

    title, *lines = summary_lines(document)
    output.say(f"[bold]{escape(title)}[/]")
    for line in lines:
        output.say(escape(line))
    for step in steps:
        output.say(f"{escape(step.purpose)}:\n  [bold]{escape(step.command)}[/]")
    rows = {
        "track used": coverage_words(document["runs"]["coverage"]),
        "a route": _route_words(document["route"]),
        "drive next": drive_words(document["next_drive"]),
    }
    if left_out := left_out_words(document["runs"]["left_out"]):
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


@reads_heightmap
def suggest_drive(
    runs: Runs,
    heightmap: MaybeHeightmap = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    effect: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Effect to find out about. [default: a confounded one, else the least certain]"
        ),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About how far to drive in all [m].")] = 200.0,
    baseline_runs: BaselineRuns = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    currents: SumOfCurrents = "auto",
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Suggest **what to drive next**: the route that best separates confounded effects or narrows a coefficient.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --robot robot.toml --runs new/*.csv`
    """
    from joulemap.service.loop.deprecated_keys import with_former_keys
    from joulemap.service.loop.next_drive import suggest_next_drive
    from joulemap.service.loop.summary import drive_words

    output, driven_by = Output(json_file), robot_of(robot)
    read, ground = _read(
        runs, baseline_runs, heightmap, driven_by, odometry, terrain_from_name, reading, currents=currents
    )
    with progress_bar("Calibrating") as report:
        found = suggest_next_drive(
            model, ground, driven_by, read, effect=effect, length_m=length, progress=report
        ).as_dict()
    output.say(escape(drive_words(found)))
    corners = found["points"][:: max(1, len(found["points"]) // _CORNERS)]
    output.table(
        {
            "corners": " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
            + ("" if found["placed"] else ", with 0,0 wherever there is room"),
            "one round": f"{found['length_m']:.0f} m, repeated for {length:.0f} m, at {_pace(found)}",
        }
    )
    output.document(with_former_keys(found))
