"""`joulemap distill`: the fast network taught by the paper's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.cluster import AsOneTask
from joulemap.service.commands.console import JsonFile, Output, progress_bar
from joulemap.service.commands.options import (
    HeightmapFile,
    Overwrite,
    Reading,
    RobotFile,
    Runs,
    find_runs,
    known_model,
    refuse_to_replace,
    robot_of,
    there,
)


def distill(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write the model to.")],
    teacher: Annotated[
        Path, typer.Option(metavar="DIR", callback=there, help="Model of `joulemap train --arch resnet18`.")
    ],
    heightmap: HeightmapFile,
    runs: Runs,
    robot: RobotFile = None,
    start_from: Annotated[
        str,
        typer.Option(
            "--from",
            "--start-from",
            metavar="M",
            callback=known_model,
            help="Compact model that the student starts from: `default` or a folder.",
        ),
    ] = "default",
    answers: Annotated[
        int, typer.Option(min=100, metavar="N", help="Number of places and headings that the teacher is asked for.")
    ] = 20_000,
    epochs: Annotated[int | None, typer.Option(min=1, metavar="N", help="Passes over the data. [default: 30]")] = None,
    charge: Annotated[
        bool, typer.Option("--charge", help="Take charge times nominal voltage as the energy, as `train`.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="The same seed and data give the same weights.")] = 0,
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
    from joulemap.model.terrain.readers import read_heightmap
    from joulemap.model.training.distillation import distil_on_runs
    from joulemap.service.models import start_folder

    output = Output(json_file)
    refuse_to_replace(out, overwrite=overwrite, mark=CONFIG_FILE)
    start = start_folder(start_from)
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
            answers=answers,
            epochs=epochs,
            charge=charge,
            seed=seed,
            progress=report,
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
