"""`joulemap calibrate`: from measured runs to what the model lacks, and to a model that has it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.console import Answer, JsonFile, progress_bar, write_file
from service.commands.models import find_runs


def calibrate(
    heightmap: Annotated[Path, typer.Option(metavar="FILE", help="Heightmap that the runs were driven on.")],
    runs: Annotated[
        list[str],
        typer.Option("--runs", metavar="GLOB", help="Runs (CSV): a file, a folder or a quoted pattern; repeatable."),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report.json, report.html and model/.")],
    model: Annotated[str, typer.Option(metavar="M", help="`default`, `physics`, or a model's folder.")] = "default",
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="FILE", help="Robot file (TOML). [default: the built-in rover]")
    ] = None,
    base_runs: Annotated[
        list[str] | None,
        typer.Option(
            "--base-runs",
            metavar="GLOB",
            help="Runs in which nothing new is at work, to hold the others against. [default: those the model was "
            "trained on, where its folder keeps them]",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the permutations: the same seed gives the same report.")] = 0,
    json_file: JsonFile = None,
) -> None:
    """Find what a **model lacks on measured runs**, name it, and write a model that has it.

    Example: `joulemap calibrate --model mine --heightmap dem.tif --robot robot.toml --runs 'new/*.csv' --out found`
    """
    from model.robot import Robot
    from model.terrain.readers import read_heightmap
    from service.calibrating import calibrate_on_runs
    from service.calibration_page import report_page

    answer = Answer(json_file)
    with progress_bar("Calibrating") as report:
        document, found = calibrate_on_runs(
            model,
            read_heightmap(heightmap),
            Robot.from_toml(robot) if robot is not None else Robot(),
            find_runs(runs),
            out=out,
            base_files=find_runs(base_runs) if base_runs else (),
            seed=seed,
            progress=report,
        )
    write_file(out / "report.json", (json.dumps(document, indent=2, allow_nan=False) + "\n").encode())
    write_file(out / "report.html", report_page(document, found).encode())
    _say(answer, document, out)
    answer.warn(document["warnings"])
    answer.document(document)


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
    answer.table(rows)
    answer.say(f"Written to {out}: report.json, report.html" + (", model/" if document["model"]["after"] else ""))


def suggest_drive(
    heightmap: Annotated[Path, typer.Option(metavar="FILE", help="Heightmap to drive on.")],
    runs: Annotated[list[str], typer.Option("--runs", metavar="GLOB", help="Runs so far (CSV), as for `calibrate`.")],
    model: Annotated[str, typer.Option(metavar="M", help="`default`, `physics`, or a model's folder.")] = "default",
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="FILE", help="Robot file (TOML). [default: the built-in rover]")
    ] = None,
    effect: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What to find out about. [default: what these runs leave most in doubt]"),
    ] = None,
    length: Annotated[float, typer.Option(min=10.0, metavar="M", help="About as far as there is time for.")] = 200.0,
    base_runs: Annotated[
        list[str] | None, typer.Option("--base-runs", metavar="GLOB", help="As for `calibrate`.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Suggest **what to drive next**: the route that tells confounded effects apart or pins a coefficient best.

    Example: `joulemap suggest-drive --model mine --heightmap dem.tif --robot robot.toml --runs 'new/*.csv'`
    """
    from model.robot import Robot
    from model.terrain.readers import read_heightmap
    from service.calibrating import suggest_next_drive

    answer = Answer(json_file)
    with progress_bar("Tracing") as report:
        found, rivals = suggest_next_drive(
            model,
            read_heightmap(heightmap),
            Robot.from_toml(robot) if robot is not None else Robot(),
            find_runs(runs),
            effect=effect,
            base_files=find_runs(base_runs) if base_runs else (),
            length_m=length,
            progress=report,
        )
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
