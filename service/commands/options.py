"""Options that several commands share. What they name must be there: else a command ends with 5 before it begins."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from joulemap.model.errors import ConflictError, NotFoundError

if TYPE_CHECKING:
    from joulemap.model.robot import Robot


def there(path: Path | None) -> Path | None:
    """A callback for files and folders that are read. Raises NotFoundError."""
    if path is not None and not path.exists():
        raise NotFoundError(f"there is no file {path}", path=str(path))
    return path


def known_model(name: str | None) -> str | None:
    """A callback for models: a name, or a folder that is there. Raises NotFoundError."""
    from joulemap.model.energy.predictor import MODEL_NAMES

    if name is not None and name not in (*MODEL_NAMES, "none") and not Path(name).is_dir():
        known = ", ".join(MODEL_NAMES)
        raise NotFoundError(
            f"there is no model {name!r}: known are {known}, or the folder of a trained model", name=name
        )
    return name


_HEIGHTMAP = typer.Option("--heightmap", metavar="FILE", callback=there, help="Heightmap that the runs were driven on.")
_RUNS = typer.Option(
    "--runs", metavar="GLOB", help="Runs (CSV, Parquet): file, folder or quoted pattern; may be repeated."
)
HeightmapFile = Annotated[Path, _HEIGHTMAP]
MaybeHeightmap = Annotated[Path | None, _HEIGHTMAP]
Runs = Annotated[list[str], _RUNS]
MaybeRuns = Annotated[list[str] | None, _RUNS]
RobotFile = Annotated[
    Path | None,
    typer.Option(
        "--robot", metavar="FILE", callback=there, help="Robot file (TOML). [default: the built-in 35 kg 4WD rover]"
    ),
]
ModelName = Annotated[
    str,
    typer.Option(
        "--model",
        metavar="M",
        callback=known_model,
        help="`default` (the shipped network), `physics`, or a model's folder.",
    ),
]
BaseRuns = Annotated[
    list[str] | None,
    typer.Option(
        "--base-runs",
        metavar="GLOB",
        help="Runs in which nothing new is at work, to hold the others against. [default: those the model was "
        "trained on, where its folder keeps them]",
    ),
]

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is at `--out` already.")]


def refuse_to_replace(out: Path, *, overwrite: bool, mark: str = "") -> None:
    """Asked before anything is computed. mark : the file without which a folder holds nothing whole. Raises
    ConflictError.
    """
    if not overwrite and (out / mark).exists():
        raise ConflictError(
            f"{out} is there already: choose another folder, or replace it with --overwrite", path=str(out)
        )


def robot_of(file: Path | None) -> Robot:
    """The robot of a file, or the built-in one. Raises RobotError."""
    from joulemap.model.robot import Robot

    return Robot.from_toml(file) if file is not None else Robot()


def find_runs(patterns: list[str]) -> list[Path]:
    """The files that patterns name, sorted within each; a folder means every CSV and Parquet file in it.

    Raises NotFoundError for none.
    """
    from glob import glob

    files = []
    for pattern in patterns:
        inside = [f"{pattern}/*.csv", f"{pattern}/*.parquet"] if Path(pattern).is_dir() else [pattern]
        found = sorted(Path(name) for each in inside for name in glob(each))
        if not found:
            where = f"the folder {pattern} holds no" if Path(pattern).is_dir() else f"{pattern!r} names no"
            raise NotFoundError(f"{where} CSV or Parquet file (looked for from {Path.cwd()})", pattern=pattern)
        files += found
    return list({file.resolve(): file for file in files}.values())
