"""Options that several commands share. A file that an option names must exist: else a command ends with 5 at once."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from joulemap.model.errors import ConflictError, InputError, NotFoundError
from joulemap.model.terrain.formats import formats_in_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot


def png(path: Path | None) -> Path | None:
    """Return the file that a picture is written to. Raises typer.BadParameter if its name says that it is no PNG."""
    if path is not None and path.suffix.lower() not in ("", ".png"):
        raise typer.BadParameter(f"pictures are PNG, and {path} does not end in .png")
    return path


Named = TypeVar("Named", Path | None, list[Path] | None)


def there(named: Named) -> Named:
    """Return the files or folders that an option names, one or several. Raises NotFoundError where one is not there."""
    for path in named if isinstance(named, list) else [] if named is None else [named]:
        if not path.exists():
            url = ":/" in str(path)  # a path has lost one of the slashes
            advice = ": joulemap reads files and asks no other machine; download it, and give the file" if url else ""
            raise NotFoundError(f"there is no file {path}{advice}", path=str(path))
    return named


_CALIBRATION = re.compile(r"cal-[0-9a-f]{12}")


def known_model(name: str | None) -> str | None:
    """Return the model that an option names. Raises NotFoundError if there is no such model."""
    from joulemap.model.energy.predictor import MODEL_NAMES

    there_already = name in (*MODEL_NAMES, "none") or _CALIBRATION.fullmatch(name or "")  # the latter at a --server
    if name is not None and not there_already and not Path(name).is_dir():
        known = ", ".join(MODEL_NAMES)
        raise NotFoundError(
            f"there is no model {name!r}: known are {known}, or the folder of a trained model", name=name
        )
    return name


_HEIGHTMAP = typer.Option("--heightmap", metavar="FILE", callback=there, help="Heightmap that the runs were driven on.")
_RUNS = typer.Option(
    "--runs",
    metavar="FILE...",
    help="Measured runs (CSV, Parquet, MCAP, bags, flight logs): files, folders or patterns like 'logs/*.csv'.",
)
HeightmapFile = Annotated[Path, _HEIGHTMAP]
HeightmapArgument = Annotated[Path, typer.Argument(metavar="HEIGHTMAP", callback=there, help=f"{formats_in_words()}.")]
MaybeHeightmap = Annotated[Path | None, _HEIGHTMAP]
Sites = Annotated[
    list[str] | None,
    typer.Option(
        "--site",
        metavar="MAP=RUNS",
        help="A heightmap and its runs, like 'dem.tif=runs/*.csv', instead of --heightmap and --runs; repeat it for "
        "several maps.",
    ),
]
Campaign = Annotated[
    Path | None,
    typer.Option(
        "--campaign",
        metavar="FILE",
        callback=there,
        help="TOML file with a table [[site]] for every map: heightmap, runs and, where needed, robot and baseline.",
    ),
]
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
BaselineRuns = Annotated[
    list[str] | None,
    typer.Option(
        "--baseline-runs",
        metavar="FILE...",
        help="Earlier runs, without what is looked for; `--runs` are compared with them. [default: those the model "
        "was trained on, if its folder keeps them]",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is at `--out` already.")]


Reading = Annotated[dict[str, Any], "joulemap.service.questions.reading:UploadOptions -name"]
"""How a heightmap's file is to be read, as `read_heightmap` takes it."""
ReadingWithLayers = Annotated[dict[str, Any], "joulemap.service.questions.reading:ReadingOptions -name"]
"""The same, with files of layers."""


def reading_words(reading: Mapping[str, Any]) -> list[str]:
    """The options that say how a heightmap's file is to be read, as they are typed, where they differ from usual."""
    from joulemap.service.questions.reading import ReadingOptions

    usual = {name: field.default for name, field in ReadingOptions.model_fields.items()}
    given = {name: value for name, value in reading.items() if value and value != usual[name]}
    layers = [
        word for role, files in given.pop("layers", {}).items() for f in files for word in ("--layer", f"{role}={f}")
    ]
    return layers + [
        word for name, value in given.items() for word in (f"--{name.removesuffix('_m').replace('_', '-')}", str(value))
    ]


def refuse_to_replace(out: Path, *, overwrite: bool, mark: str = "") -> None:
    """Refuse to replace what is there; asked before anything is computed.

    Raises ConflictError if the folder is there.
    """
    if not overwrite and (out / mark).exists():
        raise ConflictError(
            f"{out} is a file: give another name"
            if out.is_file()
            else f"{out} is there already: choose another folder, or replace it with --overwrite",
            path=str(out),
        )


def robot_of(file: Path | None) -> Robot:
    """Return the robot of a file, or the built-in one. Raises RobotError if the file is no robot file."""
    from joulemap.model.robot import Robot

    return Robot.from_toml(file) if file is not None else Robot()


def robot_words(robots: Iterable[Robot]) -> str:
    """Return which robots a command took, so that nobody gets numbers of another one without noticing."""
    from joulemap.model.robot import Robot

    found = []
    for robot in dict.fromkeys(robots):
        words = f"{robot.name}, {robot.mass_kg:g} kg, {robot.speed_mps:g} m/s"
        usual = robot == Robot()
        found.append(f"{words}: the built-in one, because no --robot FILE was given" if usual else words)
    return "; ".join(found)


def find_runs(patterns: list[str]) -> list[Path]:
    """Return the files that patterns name, each once. Raises NotFoundError if a pattern names no file."""
    from joulemap.service.library.run_files import find_run_files

    return find_run_files(patterns)


def stem_of(name: str) -> str:
    """Return a run's name as a file name: `monday/run_01.csv` is `monday_run_01`."""
    return "_".join(Path(name).with_suffix("").parts)


_OF_STATE = ("charge", "reserve")

BatteryFile = Annotated[
    Path | None,
    typer.Option(
        "--battery",
        metavar="FILE",
        callback=there,
        help="TOML with more of the battery: health, temperature_c, capacity_curve, nominal_voltage_v, open_circuit_v, "
        "resistance_ohm, cutoff_v, max_power_w, capacity_wh. Then its voltage under load is judged too.",
    ),
]


def battery_values(file: Path | None) -> dict[str, Any]:
    """The values of a battery file."""
    values: dict[str, Any] = {}
    if file is not None:
        try:
            values = tomllib.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"battery file {file}: {str(error)[:200]}", path=str(file)) from error
        for name in _OF_STATE:
            if name in values:
                raise InputError(
                    f"battery file {file} says {name}: leave it out there, and give --{name}", path=str(file), key=name
                )
    return values
