"""`joulemap reproduce`: the paper's experiments on simulated sites, and the table of what came out."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from model.errors import InputError
from service.commands.console import Answer, JsonFile, progress_bar


class ProfileName(StrEnum):
    """Extents of the reproduction."""

    DEFAULT = "default"
    FULL = "full"
    QUICK = "quick"


class HeightmapFrom(StrEnum):
    """Where the models' heightmap comes from."""

    SURVEY = "survey"
    DRIVEN = "driven"


def reproduce(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for everything; a cut-off run goes on there.")
    ],
    profile: Annotated[
        ProfileName,
        typer.Option(
            help="`default`: an hour on two cores. `full`: 256 x 256 patches. `quick`: only shows that it runs."
        ),
    ] = ProfileName.DEFAULT,
    full: Annotated[bool, typer.Option("--full", help="Short for `--profile full`.")] = False,
    seeds: Annotated[int | None, typer.Option(min=1, max=99, help="Sites, robots and drives. [default: 5]")] = None,
    backbone: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="ImageNet's ResNet18 with torchvision's names. [default: one pre-trained on simulated terrain]",
        ),
    ] = None,
    heightmap_from: Annotated[
        HeightmapFrom, typer.Option(help="A survey, or the surface fitted to the driven positions as in the paper.")
    ] = HeightmapFrom.SURVEY,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="One kind of experiment; may be repeated.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes side by side, a core each.")] = 2,
    json_file: JsonFile = None,
) -> None:
    """Reproduce the **paper's section V** on simulated sites: both networks, every training strategy, all baselines.

    Writes `REPRODUCTION.md`, `results.json` and figures into the folder. Experiments that are there already are not run
    again.

    Example: `joulemap reproduce --out reproduction`
    """
    if find_spec("sklearn") is None:
        raise InputError("the Gaussian process baseline needs scikit-learn: pip install 'joulemap[reproduce]'")
    from service.reproduction.experiments import Setting
    from service.reproduction.profiles import PROFILES
    from service.reproduction.publication import publish
    from service.reproduction.runner import run_all

    answer = Answer(json_file)
    extent = PROFILES["full" if full else profile.value]
    if seeds is not None:
        extent = replace(extent, seeds=seeds, resnet_seeds=min(seeds, extent.resnet_seeds))
    setting = Setting(out, extent, heightmap_from.value, backbone)
    with progress_bar("Reproducing") as report:
        run_all(setting, only=only or (), workers=workers, progress=report, said=answer.say)
    document = publish(setting, command=_command(out, extent.name, seeds, backbone, heightmap_from, only))
    missed = [check["wanted"] for check in document["checks"] if not check["holds"]]
    answer.say(f"[bold]Written[/] {out / 'REPRODUCTION.md'}: {len(document['checks']) - len(missed)} of "
               f"{len(document['checks'])} wanted results hold")  # fmt: skip
    answer.document(document)


def _command(
    out: Path, profile: str, seeds: int | None, backbone: Path | None, heightmap_from: HeightmapFrom,
    only: list[str] | None,
) -> str:  # fmt: skip
    """The command line again, for the document."""
    words = ["joulemap reproduce --out", str(out)]
    words += ["--profile", profile] if profile != ProfileName.DEFAULT else []
    words += ["--seeds", str(seeds)] if seeds is not None else []
    words += ["--backbone", str(backbone)] if backbone is not None else []
    words += ["--heightmap-from", heightmap_from.value] if heightmap_from is not HeightmapFrom.SURVEY else []
    for name in only or ():
        words += ["--only", name]
    return " ".join(words)
