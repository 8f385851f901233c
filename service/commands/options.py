"""Options that several commands share. A file that an option names must exist: else a command ends with 5 at once."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, get_type_hints

import typer

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.commands.console import Output

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.sites import Site


def png(path: Path | None) -> Path | None:
    """Return the file that a picture is written to.

    Parameters
    ----------
    path : Path, optional
        As it was typed.

    Returns
    -------
    Path or None
        The same.

    Raises
    ------
    typer.BadParameter
        If its name says that it is no PNG.
    """
    if path is not None and path.suffix.lower() not in ("", ".png"):
        raise typer.BadParameter(f"pictures are PNG, and {path} does not end in .png")
    return path


def there(path: Path | None) -> Path | None:
    """Return the file or folder that an option names.

    Parameters
    ----------
    path : Path, optional
        As it was typed.

    Returns
    -------
    Path or None
        The same.

    Raises
    ------
    NotFoundError
        If nothing is there.
    """
    if path is not None and not path.exists():
        url = ":/" in str(path)  # a path has lost one of the slashes
        advice = ": joulemap reads files and asks no other machine; download it, and give the file" if url else ""
        raise NotFoundError(f"there is no file {path}{advice}", path=str(path))
    return path


_CALIBRATION = re.compile(r"cal-[0-9a-f]{12}")


def known_model(name: str | None) -> str | None:
    """Return the model that an option names.

    Parameters
    ----------
    name : str, optional
        Of a model that is part of the installation, or a folder.

    Returns
    -------
    str or None
        The same.

    Raises
    ------
    NotFoundError
        If there is no such model.
    """
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
Snap = Annotated[
    bool,
    typer.Option("--snap", help="Take the nearest free place for a point on blocked ground, with a warning."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is at `--out` already.")]


class Reading(TypedDict):
    """How a heightmap's file is to be read, as `read_heightmap` takes it: what the file itself does not say."""

    resolution_m: float | None
    west_m: float
    north_m: float | None
    crs: str | None
    scale_m: float | None
    offset_m: float
    nodata: float | None
    band: int | None
    reproject: str | None
    window: str | None
    noise_m: float | None


def _heightmap_option(help: str, **more: Any) -> Any:
    return typer.Option(help=help, rich_help_panel="What the heightmap file does not say", **more)


_READING: dict[str, tuple[str, Any, Any]] = {  # option -> what the library calls it, type, default
    "resolution": (
        "resolution_m",
        Annotated[float | None, _heightmap_option("Side of a cell [m].", metavar="M")],
        None,
    ),
    "west": ("west_m", Annotated[float, _heightmap_option("x of the western edge [m].", metavar="X")], 0.0),
    "north": (
        "north_m",
        Annotated[
            float | None, _heightmap_option("y of the northern edge [m]. [default: southern edge at 0]", metavar="Y")
        ],
        None,
    ),
    "crs": (
        "crs",
        Annotated[str | None, _heightmap_option("Coordinate system in metres, like EPSG:32630.", metavar="CRS")],
        None,
    ),
    "scale": (
        "scale_m",
        Annotated[
            float | None,
            _heightmap_option("Metres per stored unit; a picture needs it. [default: 1]", metavar="M"),
        ],
        None,
    ),
    "offset": ("offset_m", Annotated[float, _heightmap_option("Height of the stored value 0 [m].", metavar="M")], 0.0),
    "nodata": (
        "nodata",
        Annotated[float | None, _heightmap_option("Stored value that means unknown.", metavar="VALUE")],
        None,
    ),
    "band": (
        "band",
        Annotated[int | None, _heightmap_option("Band or variable with the heights, from 1.", min=1, metavar="N")],
        None,
    ),
    "reproject": (
        "reproject",
        Annotated[
            str | None,
            _heightmap_option(
                "Resample a map in degrees, feet or Web Mercator, rotated or with oblong cells, to true metres: `auto` "
                "(its UTM zone) or EPSG:n. `--resolution` is then the side of the new cells.",
                metavar="auto|CRS",
            ),
        ],
        None,
    ),
    "window": (
        "window",
        Annotated[
            str | None,
            _heightmap_option(
                "Read a part of the map: two opposite corners, x,y of its CRS or latitude,longitude.",
                metavar="X,Y,X,Y",
            ),
        ],
        None,
    ),
    "noise": (
        "noise_m",
        Annotated[
            float | None,
            _heightmap_option(
                "Standard deviation of the survey's noise [m]; 0 takes the map as it is. [default: estimated from it]",
                metavar="M",
                min=0.0,
            ),
        ],
        None,
    ),
}


@contextmanager
def _warnings_said() -> Iterator[None]:
    """Say what `read_heightmap` warns of as commands say it, and not as Python does."""
    usual = warnings.showwarning

    def _say(message: Any, category: type[Warning], filename: str, *more: Any, **rest: Any) -> None:
        if category is UserWarning and "joulemap" in filename:
            Output(None).warn([str(message)])
        else:
            usual(message, category, filename, *more, **rest)

    with warnings.catch_warnings():
        warnings.showwarning = _say
        yield


def reads_heightmap(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that say how its heightmap's file is to be read.

    Parameters
    ----------
    command : callable
        Its parameter `reading` gets their values as a `Reading`.

    Returns
    -------
    callable
        The command with `--resolution`, `--west`, `--north`, `--crs`, `--scale`, `--offset`, `--nodata`, `--band`,
        `--reproject`, `--window`, `--noise`.
    """
    hints = get_type_hints(command, include_extras=True)
    parameters = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name == "reading":
            parameters += [
                inspect.Parameter(option, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=default)
                for option, (_, kind, default) in _READING.items()
            ]
        else:
            parameters.append(parameter.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY))

    @wraps(command)
    def with_options(**given: Any) -> None:
        reading = {key: given.pop(option) for option, (key, _, _) in _READING.items()}
        with _warnings_said():
            command(reading=reading, **given)

    with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {p.name: p.annotation for p in parameters}
    return with_options


def reading_words(reading: Reading) -> list[str]:
    """Return the options that say how a heightmap's file is to be read, as they are typed.

    Parameters
    ----------
    reading : Reading
        What a command was given.

    Returns
    -------
    list of str
        Options that differ from their defaults, and their values.
    """
    given = {option: (reading[key], default) for option, (key, _, default) in _READING.items()}  # type: ignore[literal-required]
    return [word for name, (value, usual) in given.items() if value != usual for word in (f"--{name}", str(value))]


def refuse_to_replace(out: Path, *, overwrite: bool, mark: str = "") -> None:
    """Refuse to replace what is there; asked before anything is computed.

    Parameters
    ----------
    out : Path
        Folder that is to be written.
    overwrite : bool
        Whether the user wants it replaced.
    mark : str
        File without which the folder holds nothing whole.

    Raises
    ------
    ConflictError
        If the folder is there.
    """
    if not overwrite and (out / mark).exists():
        raise ConflictError(
            f"{out} is a file: give another name"
            if out.is_file()
            else f"{out} is there already: choose another folder, or replace it with --overwrite",
            path=str(out),
        )


def robot_of(file: Path | None) -> Robot:
    """Return the robot of a file, or the built-in one.

    Parameters
    ----------
    file : Path, optional
        TOML.

    Returns
    -------
    Robot
        As the file declares it.

    Raises
    ------
    RobotError
        If the file is no robot file.
    """
    from joulemap.model.robot import Robot

    return Robot.from_toml(file) if file is not None else Robot()


def find_runs(patterns: list[str]) -> list[Path]:
    """Return the files that patterns name, each once.

    Parameters
    ----------
    patterns : list of str
        Files, patterns, or folders, of which every CSV and Parquet file is meant.

    Returns
    -------
    list of Path
        In the order of the patterns, sorted within each.

    Raises
    ------
    NotFoundError
        If a pattern names no file.
    """
    from joulemap.service.library.run_files import find_run_files

    return find_run_files(patterns)


def named_sites(
    heightmap: Path | None,
    runs: list[str] | None,
    site: list[str] | None,
    campaign: Path | None,
    robot: Path | None,
    reading: Reading,
) -> list[Site]:
    """Return the sites that a command line names.

    Parameters
    ----------
    heightmap, runs : Path and list of str, optional
        One heightmap and its runs.
    site : list of str, optional
        Values of `--site`.
    campaign : Path, optional
        A campaign file.
    robot : Path, optional
        Robot file of the sites that name none.
    reading : Reading
        How the heightmaps are to be read.

    Returns
    -------
    list of Site
        At least one.

    Raises
    ------
    typer.BadParameter
        If none or several ways of naming them are used.
    """
    from joulemap.model.terrain.readers import read_heightmap
    from joulemap.service.library.sites import sites_given, sites_of_options

    ways = [heightmap is not None or bool(runs), bool(site), campaign is not None]
    if sum(ways) != 1:
        raise typer.BadParameter("give --heightmap and --runs, or --site, or --campaign")
    if campaign is not None:
        return sites_given(campaign=campaign, robot=robot)
    if site:
        named = sites_of_options(site)
    elif not runs:
        raise typer.BadParameter("--heightmap and --runs go together")
    elif heightmap is None:  # drives without positions have a ground of their own
        return sites_given(runs=runs, robot=robot)
    else:
        named = [(heightmap, runs)]
    return sites_given(sites=[(read_heightmap(ground, **reading), files) for ground, files in named], robot=robot)
