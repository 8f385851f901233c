"""`joulemap train`, `distill` and `evaluate`: models made from measured runs, and how well they predict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.model.runs.words import number_words
from joulemap.service.commands.asked import Wanted, flags
from joulemap.service.commands.console import JsonFile, Output, progress_bar
from joulemap.service.commands.drives import Drives
from joulemap.service.commands.options import (
    HeightmapFile,
    ModelName,
    Overwrite,
    Reading,
    RobotFile,
    Runs,
    find_runs,
    refuse_to_replace,
    robot_of,
    robot_words,
    there,
)
from joulemap.service.commands.remote import AsOneTask
from joulemap.service.words import runs_words, turning_words


def train(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write the model to.")],
    drives: Drives,
    wanted: Annotated[Wanted, "joulemap.service.questions.training:TrainingOptions"],
    overwrite: Overwrite = False,
    scheduler: AsOneTask = None,
    json_file: JsonFile = None,
) -> None:
    """Train a **model** on measured runs, for your robot on your ground.

    Turning, time and speeding up are fitted together with the network, from every driven metre. Drives with a speed or
    a distance and no positions need no heightmap: rolling and climbing are fitted, and the shape of the ground costs
    nothing. Without runs the shipped network is trained again, on simulated data.

    Examples:

    `joulemap train --heightmap dem.tif --robot robot.toml --runs logs/*.csv --out mine`

    `joulemap train --site a.tif=a/*.csv --site b.tif=b.csv --robot robot.toml --out mine` (several maps)

    `joulemap train --out weights` (the shipped network)
    """
    from joulemap.model.energy.artifact import CONFIG_FILE

    output = Output(json_file)
    refuse_to_replace(out, overwrite=overwrite, mark=CONFIG_FILE)
    if not drives.named:
        idle = [flags(name)[0] for name in wanted.typed if name in wanted and name != "seed"]
        if drives.robot is not None:
            idle.append("--robot")
        if idle:
            raise typer.BadParameter(f"{', '.join(idle)}: only with runs")
        from joulemap.model.training.pretraining import DEFAULT_SEED, train_default

        with progress_bar("Training the shipped network") as report:
            trained = train_default(
                out, seed=DEFAULT_SEED if (seed := wanted.typed["seed"]) is None else seed, progress=report
            )
        output.say(f"{out}: held-out error {trained['held_out']['mean_relative_error']:.1%}", head="Trained")
        output.document({"out": str(out), **trained})
        return
    from joulemap.model.runs.segments import coverage_words
    from joulemap.service.library import models as library

    sites = drives.sites()
    with progress_bar("Training") as report:
        made = library.train(sites=sites, out=out, overwrite=overwrite, progress=report, **wanted.typed).facts
    costs = made["drive_costs"]
    driving_w = costs["driving_w"] or 0.0
    more = "less" if driving_w < 0.0 else "more"
    output.say(f"{out}, version {made['version']}, {made['epochs']} epochs", head="Trained")
    output.table(
        {
            "robot": robot_words(site.robot for site in sites),
            "learned from": f"{made['segments']:,} segments of {runs_words(len(made['runs']))}",
            "held out": f"{_held_out_words(made)}: {_errors_words(made['held_out'])}"
            + (" (a little too low: these runs decided when to stop)" if made["stopped_by_held_out"] else ""),
            "held-out error": _share_words(made["held_out"]),
            **{
                f"  {name}": _share_words(found)
                for name, found in made["baselines"].items()
                if name != "the same without fine-tuning"
            },
            "track used": coverage_words(made["coverage"]),
            "turning": turning_words(made),
            "speeding up": f"{number_words(costs['speed_up_kg'])} J for each m2/s2 of half the squared speed",
            "driving": f"{number_words(abs(driving_w))} W {more} than the declared idle power",
        }
    )
    output.warn(made["warnings"])
    if not made["keeps_runs"]:
        why = "they are too few, lack a voltage, or do not lie on one map"
        output.warn([f"the runs are not kept beside the model ({why}): give them to `calibrate` as --baseline-runs"])
    output.document({"out": str(out), **made})


def evaluate(
    drives: Drives,
    wanted: Annotated[dict[str, Any], "joulemap.service.questions.training:EvaluationOptions"],
    model: ModelName = "default",
    json_file: JsonFile = None,
) -> None:
    """Measure how well a **model predicts measured runs**, per segment and over whole runs.

    Drives with a speed or a distance and no positions need no heightmap: each is compared on a strip with the heights
    of its log.

    Example: `joulemap evaluate --model mine --heightmap dem.tif --robot robot.toml --runs logs/*.csv`
    """
    from joulemap.model.runs.segments import coverage_words
    from joulemap.model.runs.words import count_words
    from joulemap.service.library import models as library

    output = Output(json_file)
    sites = drives.sites()
    found = library.evaluate(sites=sites, model=model, **wanted).document
    output.say(
        f"on {runs_words(len(found['route_relative_errors']))}: {_errors_words(found)}", head=f"Model {found['model']}"
    )
    output.table(
        {
            "robot": robot_words(site.robot for site in sites),
            "segments": f"{found['segments']:,} ({found['unknown']:,} more on unknown ground)",
            "track used": coverage_words(found["used"]),
            "not used": count_words(found["left_out"]) or "nothing",
            "repaired": count_words(_sums(found["repairs"])) or "nothing",
            "median error": f"{found['median_relative_error']:.1%} of a segment's energy",
            "whole runs": f"{found['route_relative_error']:.1%} of a run's energy",
            "bias": f"{found['bias_j']:+.2f} J per segment (measured - predicted)",
            "intervals": _coverage_words(found["coverage"]),
        }
    )
    output.warn(found["warnings"])
    output.document(found)


def _share_words(found: dict[str, Any]) -> str:
    rmse, absolute = number_words(found["rmse_j"]), number_words(found["mean_absolute_error_j"])
    share = f"{found['error_share']:.1%} of its energy"
    return f"{rmse} J root mean square, {absolute} J mean absolute error of a segment ({share})"


def _coverage_words(covered: dict[str, float] | None) -> str:
    if covered is None:
        return "none: this model does not say how far off it may be"
    (first, share), *others = covered.items()
    rest = "".join(f", {100 * s:.0f} % inside the {level} % interval" for level, s in others)
    return f"{100 * share:.0f} % of the segments lie inside the {first} % interval{rest}"


def _held_out_words(made: dict[str, Any]) -> str:
    if set(made["held_out_runs"]) != set(made["runs"]):
        return f"{', '.join(made['held_out_runs'])}, which the network had not seen"
    whole = "each run" if len(made["runs"]) > 1 else "each part of the run"
    return f"{whole} predicted by networks that had not seen it"


def _sums(repairs: dict[str, dict[str, int]]) -> dict[str, int]:
    """Repairs of all runs together, by key."""
    sums: dict[str, int] = {}
    for counts in repairs.values():
        for key, count in counts.items():
            sums[key] = sums.get(key, 0) + count
    return sums


def _errors_words(found: dict[str, Any]) -> str:
    return f"mean error {found['mean_relative_error']:.1%} per 1 m segment"


def distill(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write the model to.")],
    teacher: Annotated[
        Path, typer.Option(metavar="DIR", callback=there, help="Model of `joulemap train --arch resnet18`.")
    ],
    heightmap: HeightmapFile,
    runs: Runs,
    wanted: Annotated[dict[str, Any], "joulemap.service.questions.training:DistillationOptions"],
    robot: RobotFile = None,
    overwrite: Overwrite = False,
    scheduler: AsOneTask = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Distil a slow **ResNet18 into the fast network**, which learns from its answers and from the measured segments.

    The answer says how far the two differ, and how well both predict runs that neither was trained on.

    Example: `joulemap distill --teacher paper --heightmap dem.tif --robot robot.toml --runs logs/*.csv --out fast`
    """
    from dataclasses import asdict

    from joulemap.model.energy.artifact import CONFIG_FILE
    from joulemap.model.training.distillation import distil_on_runs
    from joulemap.service.library.heightmaps import read_heightmap
    from joulemap.service.models import start_folder

    output = Output(json_file)
    refuse_to_replace(out, overwrite=overwrite, mark=CONFIG_FILE)
    start = start_folder(wanted.pop("start_from"))
    if start is None:
        raise typer.BadParameter("--from none: a student starts from a compact model")
    with progress_bar("Distilling") as report:
        model = distil_on_runs(
            read_heightmap(heightmap, **reading),
            robot_of(robot),
            find_runs(runs),
            teacher=teacher,
            start_from=start,
            out=out,
            progress=report,
            **wanted,
        )
    student, taught = (e["mean_relative_error"] for e in (model.student_held_out, model.teacher_held_out))
    output.say(f"{teacher} into {out}, version {model.version}", head="Distilled")
    output.table(
        {
            "learned from": f"{model.answers} answers of the teacher and {model.segments} measured segments",
            "differs by": f"{model.difference:.1%} of the energy, where no run was driven",
            "held out": f"{', '.join(model.held_out_runs)}: student {student:.1%}, teacher {taught:.1%} per segment",
        }
    )
    output.document({"out": str(out), **asdict(model)})
