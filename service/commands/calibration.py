"""`joulemap calibrate` and `suggest-drive`: what measured runs show that a model lacks, and what to drive next."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.console import Answer, JsonFile, parse_point, progress_bar, write_file
from joulemap.service.commands.options import (
    BaseRuns,
    MaybeHeightmap,
    ModelName,
    RobotFile,
    Runs,
    find_runs,
    robot_of,
)
from joulemap.service.words import energy_words, runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.files import CalibrationRuns
    from joulemap.model.terrain.heightmap import Heightmap

_CORNERS = 8  # of a route

OdometryTrack = Annotated[
    float | None,
    typer.Option(
        "--odometry",
        metavar="TRACK",
        help="The runs have no positions: integrate speed_left and speed_right on level ground (no `--heightmap`), "
        "for wheels whose sides are so far apart as the robot turns [m].",
    ),
]
TerrainFromName = Annotated[
    bool, typer.Option("--terrain-from-name", help="With `--odometry`: snow_02.csv was driven on snow.")
]


def calibrate(
    runs: Runs,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    heightmap: MaybeHeightmap = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    base_runs: BaseRuns = None,
    keep_aside: Annotated[
        list[str] | None,
        typer.Option(
            "--keep-aside",
            metavar="GLOB",
            help="Runs (also of `--runs`) that nothing is sought or fitted in: the report has the error on them before "
            "and after.",
        ),
    ] = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    start: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="Task whose route is compared before and after [m].")
    ] = None,
    goal: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="[default: a few between places the runs visited]")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the permutations: the same seed gives the same report.")] = 0,
    json_file: JsonFile = None,
) -> None:
    """Find what a **model lacks on measured runs**, name it, and write a model that has it.

    Example: `joulemap calibrate --model mine --heightmap dem.tif --robot robot.toml --runs 'new/*.csv' --out found`
    """
    from joulemap.service.loop.calibration import calibrate_on_runs
    from joulemap.service.loop.report_page import report_page

    if (start is None) != (goal is None):
        raise typer.BadParameter("--start and --goal go together")
    answer, began, driven_by = Answer(json_file), time.perf_counter(), robot_of(robot)
    read, ground = _read(runs, base_runs, heightmap, driven_by, odometry, terrain_from_name, keep_aside=keep_aside)
    with progress_bar("Calibrating") as report:
        made = calibrate_on_runs(
            model,
            ground,
            driven_by,
            read,
            out=out,
            task=None if start is None else (start, goal),
            seed=seed,
            progress=report,
        )
    write_file(out / "report.json", (json.dumps(made.document, indent=2, allow_nan=False) + "\n").encode())
    write_file(out / "report.html", report_page(made, ground).encode())
    _say(answer, made.document, out)
    count = len(read.segments.runs) + (0 if read.aside is None else len(read.aside.runs))
    answer.say(
        f"{runs_words(count)}, {read.rows:,} rows, {made.document['segments']['fit']:,} segments in "
        f"{time.perf_counter() - began:.0f} s"
    )
    answer.warn(made.document["warnings"])
    answer.document(made.document)


def _read(
    runs: list[str],
    base_runs: list[str] | None,
    heightmap: Path | None,
    robot: Robot,
    odometry: float | None,
    terrain_from_name: bool,
    *,
    keep_aside: list[str] | None = None,
) -> tuple[CalibrationRuns, Heightmap]:
    """The runs that the options name, and the map or level ground that they were driven on."""
    from joulemap.model.runs.files import read_calibration_runs, read_odometry_runs
    from joulemap.model.runs.odometry import Odometry
    from joulemap.model.terrain.readers import read_heightmap

    if (heightmap is None) == (odometry is None):
        raise typer.BadParameter("give either --heightmap, or --odometry for runs without positions")
    if terrain_from_name and odometry is None:
        raise typer.BadParameter("--terrain-from-name goes with --odometry")
    aside = find_runs(keep_aside or [])
    apart = {file.resolve() for file in aside}
    files = [file for file in find_runs(runs) if file.resolve() not in apart]
    more = {"base_files": find_runs(base_runs or []), "aside_files": aside}
    if odometry is not None:
        return read_odometry_runs(files, Odometry(odometry, terrain_from_name), **more)
    assert heightmap is not None
    ground = read_heightmap(heightmap)
    return read_calibration_runs(files, robot, crs=ground.frame.crs, **more), ground


def _say(answer: Answer, document: dict[str, Any], out: Path) -> None:
    from joulemap.service.loop.report_page import coefficient_words, shadow_words

    unit = "A s" if document["target"] == "charge_as" else "J"
    names = ", ".join(effect["name"] for effect in document["effects"])
    answer.say(f"[bold]Found {names}[/]" if names else "[bold]Nothing found[/] that the model lacks")
    rows = {}
    for effect in document["effects"]:
        plans = "" if effect["in_plans"] else "; a diagnosis, not in plans"
        rows[effect["name"]] = (
            f"{', '.join(coefficient_words(effect))}; p = {effect['p_value']:.2g}, {effect['where']}{plans}"
        )
    if words := shadow_words(document):
        rows["beside it"] = words
    rows |= _error_words(document["error"], unit, "")
    if "kept_aside" in document:
        rows |= _error_words(document["kept_aside"]["error"], unit, ", kept aside")
    for group in document["confounded"]:
        rows[f"like {group[0]}"] = f"these runs cannot tell it from {', '.join(group[1:])}"
    rows["a route"] = _route_words(document["route"])
    rows["drive next"] = _drive_words(document["next_drive"])
    answer.table(rows)
    answer.say(f"Written to {out}: report.json, report.html" + (", model/" if document["model"]["after"] else ""))


def _error_words(error: Mapping[str, Any], unit: str, where: str) -> dict[str, str]:
    from joulemap.service.loop.report_page import error_states

    states = error_states(error)
    return {
        f"{name} error{where}": ", ".join(f"{scale * error[k][key]:.3g}{suffix} {words}" for k, words in states.items())
        for key, name, scale, suffix in (
            ("mean_relative", "mean relative", 100.0, " %"),
            ("rmse", "root mean square", 1.0, f" {unit}"),
        )
    }


def _route_words(route: Mapping[str, Any]) -> str:
    if "why_not" in route:
        return f"not compared: {route['why_not']}"
    (x0, y0), (x1, y1) = route["task"]["start"], route["task"]["goal"]
    old, new = (energy_words(route[key]["energy_j"]) for key in ("before", "after"))
    old_before, new_before = (energy_words(route[key]["energy_at_old_prices_j"]) for key in ("before", "after"))
    volts = f"; charge times {route['nominal_voltage_v']:g} V" if "nominal_voltage_v" in route else ""
    return (
        f"{x0:.1f},{y0:.1f} to {x1:.1f},{y1:.1f} ({route['task']['chosen']}): by the new model {old} the old way, "
        f"{new} the new one, {route['saving_percent']:.1f} % saved; by the old one {old_before} and {new_before}{volts}"
    )


def _drive_words(drive: Mapping[str, Any]) -> str:
    if "why_not" in drive:
        return f"no suggestion: {drive['why_not']}"
    rivals = f" from {', '.join(drive['tells_from'])}" if drive["tells_from"] else ""
    x, y = drive["points"][0]
    where = f" near {x:.1f},{y:.1f}" if drive["placed"] else ""
    return (
        f"{drive['kind']}{where} for {drive['total_length_m']:.0f} m at {_pace(drive)}: to "
        f"{'tell' if rivals else 'pin'} {drive['effect']}{rivals}, whose interval would be "
        f"{drive['expected_interval_share']:.0%} as wide"
    )


def _pace(drive: Mapping[str, Any]) -> str:
    return " and ".join(f"{v:.2f} m/s" for v in drive["speeds_mps"])


def suggest_drive(
    runs: Runs,
    heightmap: MaybeHeightmap = None,
    model: ModelName = "default",
    robot: RobotFile = None,
    effect: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What to find out about. [default: what these runs leave most in doubt]"),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About as far as there is time for.")] = 200.0,
    base_runs: BaseRuns = None,
    odometry: OdometryTrack = None,
    terrain_from_name: TerrainFromName = False,
    json_file: JsonFile = None,
) -> None:
    """Suggest **what to drive next**: the route that tells confounded effects apart or pins a coefficient best.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --robot robot.toml --runs 'new/*.csv'`
    """
    from joulemap.service.loop.next_drive import suggest_next_drive

    answer, driven_by = Answer(json_file), robot_of(robot)
    read, ground = _read(runs, base_runs, heightmap, driven_by, odometry, terrain_from_name)
    with progress_bar("Tracing") as report:
        found = suggest_next_drive(
            model, ground, driven_by, read, effect=effect, length_m=length, progress=report
        ).as_dict()
    answer.say(f"[bold]Drive {found['kind']}[/] to learn about {found['effect']}")
    corners = found["points"][:: max(1, len(found["points"]) // _CORNERS)]
    rows = {
        "through": " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        + ("" if found["placed"] else ", with 0,0 wherever there is room"),
        "one round": f"{found['length_m']:.0f} m, over and over for {length:.0f} m, at {_pace(found)}",
        "expected": f"an interval {found['expected_interval_share']:.0%} as wide as now",
    }
    if found["tells_from"]:
        rows["tells it from"] = ", ".join(found["tells_from"])
    answer.table(rows)
    answer.document(found)
