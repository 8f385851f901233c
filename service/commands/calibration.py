"""`joulemap calibrate` and `suggest-drive`: what measured runs show that a model lacks, and what to drive next."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.console import Answer, JsonFile, parse_point, progress_bar, write_file
from service.commands.options import BaseRuns, HeightmapFile, ModelName, RobotFile, Runs, find_runs, robot_of
from service.commands.words import energy_words


def calibrate(
    heightmap: HeightmapFile,
    runs: Runs,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    model: ModelName = "default",
    robot: RobotFile = None,
    base_runs: BaseRuns = None,
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
    from model.terrain.readers import read_heightmap
    from service.loop.calibrating import calibrate_on_runs
    from service.loop.page import report_page

    if (start is None) != (goal is None):
        raise typer.BadParameter("--start and --goal go together")
    answer = Answer(json_file)
    ground = read_heightmap(heightmap)
    with progress_bar("Calibrating") as report:
        made = calibrate_on_runs(
            model, ground, robot_of(robot), find_runs(runs), base_files=find_runs(base_runs or []), out=out,
            task=None if start is None else (start, goal), seed=seed, progress=report,
        )  # fmt: skip
    write_file(out / "report.json", (json.dumps(made.document, indent=2, allow_nan=False) + "\n").encode())
    write_file(out / "report.html", report_page(made, ground).encode())
    _say(answer, made.document, out)
    answer.warn(made.document["warnings"])
    answer.document(made.document)


def _say(answer: Answer, document: dict[str, Any], out: Path) -> None:
    error, unit = document["error"], "A s" if document["target"] == "charge_as" else "J"
    names = ", ".join(effect["name"] for effect in document["effects"])
    answer.say(f"[bold]Found {names}[/]" if names else "[bold]Nothing found[/] that the model lacks")
    rows = {}
    for effect in document["effects"]:
        first = effect["coefficients"][:2]
        values = ", ".join(
            f"{c['value']:.4g} {c['unit']} ({c['ci95'][0]:.4g} to {c['ci95'][1]:.4g})".replace("  ", " ") for c in first
        )
        more = f" and {len(effect['coefficients']) - 2} more" if len(effect["coefficients"]) > 2 else ""
        plans = "" if effect["in_plans"] else "; a diagnosis, not in plans"
        rows[effect["name"]] = f"{values}{more}, p = {effect['p_value']:.2g}, {effect['where']}{plans}"
    for key in ("mean_relative", "rmse"):
        scale, suffix = (100.0, " %") if key == "mean_relative" else (1.0, f" {unit}")
        rows[f"{key.replace('_', ' ')} error"] = (
            f"{scale * error['before'][key]:.3g}{suffix} before, {scale * error['after'][key]:.3g}{suffix} after, "
            f"{scale * error['after_planner'][key]:.3g}{suffix} with what a planner knows"
        )
    for group in document["confounded"]:
        rows[f"like {group[0]}"] = f"these runs cannot tell it from {', '.join(group[1:])}"
    rows["a route"] = _route_words(document["route"])
    answer.table(rows)
    answer.say(f"Written to {out}: report.json, report.html" + (", model/" if document["model"]["after"] else ""))


def _route_words(route: Mapping[str, Any]) -> str:
    if "why_not" in route:
        return f"not compared: {route['why_not']}"
    (x0, y0), (x1, y1) = route["task"]["start"], route["task"]["goal"]
    old, new = (energy_words(route[key]["energy_j"]) for key in ("before", "after"))
    return (
        f"{x0:.1f},{y0:.1f} to {x1:.1f},{y1:.1f} ({route['task']['chosen']}): {old} the old way, {new} the new one, "
        f"{route['saving_percent']:.1f} % saved"
    )


def suggest_drive(
    heightmap: HeightmapFile,
    runs: Runs,
    model: ModelName = "default",
    robot: RobotFile = None,
    effect: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What to find out about. [default: what these runs leave most in doubt]"),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About as far as there is time for.")] = 200.0,
    base_runs: BaseRuns = None,
    json_file: JsonFile = None,
) -> None:
    """Suggest **what to drive next**: the route that tells confounded effects apart or pins a coefficient best.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --robot robot.toml --runs 'new/*.csv'`
    """
    from model.terrain.readers import read_heightmap
    from service.loop.calibrating import suggest_next_drive

    answer = Answer(json_file)
    with progress_bar("Tracing") as report:
        found, rivals = suggest_next_drive(
            model, read_heightmap(heightmap), robot_of(robot), find_runs(runs), base_files=find_runs(base_runs or []),
            effect=effect, length_m=length, progress=report,
        )  # fmt: skip
    corners = [[round(float(x), 2), round(float(y), 2)] for x, y in found.points]
    answer.say(f"[bold]Drive {found.kind}[/] to learn about {found.effect}")
    shown = corners if len(corners) <= 9 else corners[:: len(corners) // 8]
    rows = {
        "through": " ".join(f"{x:.1f},{y:.1f}" for x, y in shown),
        "one round": f"{found.length_m:.0f} m, over and over for {length:.0f} m, at "
        + " and ".join(f"{v:.2f} m/s" for v in found.speeds),
        "expected": f"an interval {found.shrinkage:.0%} as wide as now",
    }
    if rivals:
        rows["tells it from"] = ", ".join(rivals)
    answer.table(rows)
    answer.document(
        {
            "effect": found.effect,
            "tells_from": rivals,
            "kind": found.kind,
            "points": corners,
            "speeds_mps": list(found.speeds),
            "length_m": found.length_m,
            "expected_interval_share": found.shrinkage,
        }
    )
