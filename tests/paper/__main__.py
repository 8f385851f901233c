"""`python -m tests.paper`: the paper's experiments on simulated sites, and simple methods on any runs."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.asked import with_options
from joulemap.service.commands.console import Command, JsonFile, Output, PlainErrors, progress_bar
from joulemap.service.commands.options import (
    HeightmapFile,
    Reading,
    RobotFile,
    Runs,
    find_runs,
    robot_of,
    there,
)
from joulemap.service.words import runs_words

app = typer.Typer(
    name="python -m tests.paper",
    cls=PlainErrors,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Section V of the paper (Wei & Isler 2022) on simulated sites, and its simple methods on your own runs.",
    epilog="To see in minutes that it runs: `python -m tests.paper reproduce --out paper --profile quick --seeds 1`.",
)


class ProfileName(StrEnum):
    """Extents of the reproduction."""

    DEFAULT = "default"
    FULL = "full"
    QUICK = "quick"


class HeightmapFrom(StrEnum):
    """Where the models' heightmap comes from."""

    SURVEY = "survey"
    DRIVEN = "driven"


@app.command(cls=Command)
def reproduce(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for everything; an interrupted run is continued there.")
    ],
    profile: Annotated[
        ProfileName,
        typer.Option(
            help="`default`: an hour on two cores. `full`: 256 x 256 patches. `quick`: only shows that it runs."
        ),
    ] = ProfileName.DEFAULT,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=99, metavar="N", help="Sites, robots and drives. [default: 5]")
    ] = None,
    backbone: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=there,
            help="ImageNet's ResNet18 with torchvision's names. [default: one pre-trained on simulated terrain]",
        ),
    ] = None,
    heightmap_from: Annotated[
        HeightmapFrom, typer.Option(help="A survey, or the surface fitted to the driven positions as in the paper.")
    ] = HeightmapFrom.SURVEY,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME...", help="Only these kinds of experiments.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, metavar="N", help="Processes side by side, a core each.")] = 2,
    json_file: JsonFile = None,
) -> None:
    """Reproduce the **paper's section V** on simulated sites: both networks, every training strategy, all baselines.

    Writes `TABLES.md` and `results.json` into the folder. Experiments that are in it already are not run again.

    Example: `python -m tests.paper reproduce --out reproduction`
    """
    from tests.paper.profiles import PROFILES
    from tests.paper.report import publish
    from tests.paper.runner import run_all
    from tests.paper.setting import Setting

    output = Output(json_file)
    extent = PROFILES[profile.value]
    if seeds is not None:
        extent = replace(extent, seeds=seeds, resnet_seeds=min(seeds, extent.resnet_seeds))
    setting = Setting(out, extent, heightmap_from.value, backbone)
    with progress_bar("Reproducing") as report:
        run_all(setting, only=only or (), workers=workers, progress=report, said=output.say)
    document = publish(setting, command=_command(out, extent.name, seeds, backbone, heightmap_from, only))
    missed = [check["wanted"] for check in document["checks"] if not check["holds"]]
    output.say(
        f"{out / 'TABLES.md'}: {len(document['checks']) - len(missed)} of "
        f"{len(document['checks'])} wanted results hold",
        head="Written",
    )
    output.document(document)


@app.command(cls=Command)
@with_options
def baselines(
    heightmap: HeightmapFile,
    runs: Runs,
    test: Annotated[
        list[str],
        typer.Option("--test-runs", metavar="FILE...", help="Test set: runs that nothing is fitted to."),
    ],
    test_heightmap: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", callback=there, help="Heightmap of the test runs, read like the other. [default: the same]"
        ),
    ] = None,
    model: Annotated[
        list[str] | None, typer.Option("--model", metavar="M...", help="Models to judge beside them.")
    ] = None,
    robot: RobotFile = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Fit **simple methods** to measured runs: one friction, a friction map, a ridge regression on the terrain's shape.

    A trained model has to predict better than these. Runs that are in both `--runs` and `--test-runs` are only tested.

    Example: `python -m tests.paper baselines --heightmap dem.tif --runs logs/*.csv --test-runs logs/run_06.csv`
    """
    from joulemap.service.library.heightmaps import read_heightmap
    from joulemap.service.models import find_predictor
    from tests.paper.comparison import compare

    output = Output(json_file)
    rover = robot_of(robot)
    tested = find_runs(test)
    learned = [file for file in find_runs(runs) if file not in tested]
    elsewhere = read_heightmap(test_heightmap, **reading) if test_heightmap is not None else None
    found = compare(
        read_heightmap(heightmap, **reading),
        rover,
        learned,
        tested,
        tested_heightmap=elsewhere,
        models=[find_predictor(name) for name in model or ()],
    )
    output.say(f"to {runs_words(len(learned))}, judged on {len(tested)}: mean error per 1 m segment", head="Fitted")
    output.table(
        {
            name: f"{one['mean_relative_error']:.1%} straight, {one['with_turns']:.1%} with turns, "
            f"{one['route_relative_error']:.1%} of a whole run"
            for name, one in found.items()
        }
    )
    output.document({"learned": [str(f) for f in learned], "tested": [str(f) for f in tested], "methods": found})


def _command(
    out: Path,
    profile: str,
    seeds: int | None,
    backbone: Path | None,
    heightmap_from: HeightmapFrom,
    only: list[str] | None,
) -> str:
    """The command line again, for the document."""
    words = ["python -m tests.paper reproduce --out", str(out)]
    words += ["--profile", profile] if profile != ProfileName.DEFAULT else []
    words += ["--seeds", str(seeds)] if seeds is not None else []
    words += ["--backbone", str(backbone)] if backbone is not None else []
    words += ["--heightmap-from", heightmap_from.value] if heightmap_from is not HeightmapFrom.SURVEY else []
    for name in only or ():
        words += ["--only", name]
    return " ".join(words)


if __name__ == "__main__":
    app()
