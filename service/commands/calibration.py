"""`joulemap calibrate` and `suggest-drive`: what measured runs show that a model lacks, and what to drive next."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, json_text, progress_bar, write_file
from joulemap.service.commands.drives import ComparedDrives
from joulemap.service.commands.options import robot_words
from joulemap.service.commands.remote import AsOneTask
from joulemap.service.commands.route_files import RouteFiles
from joulemap.service.words import energy_words, runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.service.loop.summary import NextStep

_CORNERS = 8  # of a route


def calibrate(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    drives: ComparedDrives,
    wanted: Annotated[dict[str, Any], "joulemap.service.questions.calibrating:CalibrationOptions"],
    test_runs: Annotated[
        list[str] | None,
        typer.Option(
            "--test-runs",
            metavar="FILE...",
            help="Runs (also some of `--runs`) that are not used to find or fit effects: the report has the error on "
            "them before and after. With `--site` and `--campaign`: some of their runs.",
        ),
    ] = None,
    scheduler: AsOneTask = None,
    json_file: JsonFile = None,
) -> None:
    """Find what a **model lacks on measured runs**, name it, and write a calibrated model.

    Examples:

    `joulemap calibrate --model mine --heightmap dem.tif --robot robot.toml --runs new/*.csv --out found`

    `joulemap calibrate --model mine --site a.tif=a/*.csv --site b.tif=b.csv --robot robot.toml --out found` (several
    maps, one robot)

    `joulemap calibrate --model physics --robot car.toml --runs drives --out found` (logs with a speed or a distance and
    no positions; the heights are those of the log)
    """
    from joulemap.service.loop.report_page import report_page
    from joulemap.service.questions.calibrating import CalibrationOptions, ask
    from joulemap.service.questions.given import checked

    if (wanted["start"] is None) != (wanted["goal"] is None):
        raise typer.BadParameter("--start and --goal go together")
    output, began = Output(json_file), time.perf_counter()
    options, read = checked(CalibrationOptions, wanted), drives.read(test_runs)
    with progress_bar("Calibrating") as report:
        made = ask(drives.model, read, options, out=out, progress=report)
    steps = _next_steps(made.document, out, drives, read.robot)
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


def _next_steps(document: Mapping[str, Any], out: Path, asked: ComparedDrives, robot: Robot) -> list[NextStep]:
    """What to type after a calibration."""
    from joulemap.service.loop.summary import NextStep, advice, likeliest

    steps = [] if advice(document) else _plan_with(document, out, asked, robot)
    words = ["joulemap", "suggest-drive", *asked.words()]
    if document["effects"]:
        steps.append(NextStep("Get the drive that would make the answer more certain", shlex.join(words)))
    elif names := likeliest(document):
        effect = names[0][0]
        purpose = f"Get a drive that would show whether there is an effect of {effect}"
        steps.append(NextStep(purpose, shlex.join([*words, "--effect", effect])))
    return steps


def _plan_with(document: Mapping[str, Any], out: Path, asked: ComparedDrives, robot: Robot) -> list[NextStep]:
    """What to type to plan with the calibrated model."""
    from joulemap.service.loop.summary import NextStep

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
    from joulemap.service.loop.summary import drive_words, summary_lines

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
    drives: ComparedDrives,
    effect: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Effect to find out about. [default: a confounded one, else the least certain]"
        ),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About how far to drive in all [m].")] = 200.0,
    json_file: JsonFile = None,
    *,
    route_files: RouteFiles,
) -> None:
    """Suggest **what to drive next**: the route that best separates confounded effects or narrows a coefficient.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --runs new/*.csv --out drive.plan`
    """
    from joulemap.service.exports.track import track_of_drive
    from joulemap.service.loop.next_drive import suggest_next_drive
    from joulemap.service.loop.summary import drive_words, with_former_keys

    output, files = Output(json_file), route_files.wanted()
    read = drives.read()
    with progress_bar("Calibrating") as report:
        found = suggest_next_drive(drives.model, read, effect=effect, length_m=length, progress=report).as_dict()
    output.say(drive_words(found))
    corners = found["points"][:: max(1, len(found["points"]) // _CORNERS)]
    output.table(
        {
            "corners": " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
            + ("" if found["placed"] else ", with 0,0 wherever there is room"),
            "one round": f"{found['length_m']:.0f} m, repeated for {length:.0f} m, at {_pace(found)}",
        }
    )
    for path, file in files:
        write_file(path, file.written(track_of_drive(found)))
    output.document(with_former_keys(found))
