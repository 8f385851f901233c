"""Measured runs for a Python user: read them, train a model on them, evaluate it, and find what it lacks."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import InputError, NotFoundError
from joulemap.model.runs.reader import Run
from joulemap.service.library.heightmaps import GroundLike, RobotLike, ground_of, robot_of
from joulemap.service.library.html import html_table, text_table
from joulemap.service.models import CALIBRATED_FOLDER, DEFAULT_MODEL
from joulemap.service.words import duration_words, runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.files import CalibrationRuns
    from joulemap.model.terrain.heightmap import Heightmap
    from joulemap.service.loop.rerouting import Task

Point = Sequence[float]
REPORT_JSON, REPORT_HTML = "report.json", "report.html"
"""What `calibrate` writes beside the calibrated model."""
RUN_SUFFIXES = (".csv", ".parquet")
"""Files that a folder of runs is searched for."""


@dataclass(frozen=True, eq=False, repr=False)
class Runs:
    """Measured runs, read and repaired.

    Attributes
    ----------
    files : tuple of Path
        Where they were read from.
    runs : tuple of Run
        What was read, in the same order.
    """

    files: tuple[Path, ...]
    runs: tuple[Run, ...]

    @property
    def names(self) -> list[str]:
        """A name of each run, no two alike."""
        return [run.name for run in self.runs]

    @property
    def repairs(self) -> dict[str, dict[str, int]]:
        """Rows that were repaired or dropped, by run and rule."""
        return {run.name: run.repairs for run in self.runs if run.repairs}

    def __len__(self) -> int:
        return len(self.runs)

    def _rows(self) -> dict[str, str]:
        return {
            run.name: f"{len(run):,} rows, {duration_words(float(run.t[-1] - run.t[0]))}, "
            f"{'voltage and current' if run.voltage_v is not None else 'current without voltage'}, "
            f"{sum(run.repairs.values()):,} rows repaired or dropped"
            for run in self.runs
        }

    def __repr__(self) -> str:
        return f"<Runs: {runs_words(len(self))}, {sum(len(run) for run in self.runs):,} rows>"

    def __str__(self) -> str:
        return text_table(runs_words(len(self)), self._rows())

    def _repr_html_(self) -> str:
        return html_table(runs_words(len(self)), self._rows())


RunsLike = Runs | str | Path | Sequence[str | Path]
"""Runs, or a file, a folder, a pattern such as "logs/*.csv", or several of these."""


def read_runs(files: RunsLike, *, crs: str | None = None) -> Runs:
    """Read measured runs.

    Parameters
    ----------
    files : str, Path or sequence of these
        Files (CSV or Parquet), folders, or patterns such as "logs/*.csv".
    crs : str, optional
        Coordinate system of the heightmap, for logs that have `lat` and `lon` instead of `x` and `y`.

    Returns
    -------
    Runs
        One for each file.

    Raises
    ------
    NotFoundError
        If a file, folder or pattern names no file.
    RunsError
        If a file is no usable run. The message names the file, the column and the row.
    """
    from joulemap.model.runs.files import distinct_names
    from joulemap.model.runs.reader import read_run

    if isinstance(files, Runs):
        return files
    paths = find_run_files(files)
    names = distinct_names(paths)
    runs = tuple(read_run(path, name=name, crs=crs) for path, name in zip(paths, names, strict=True))
    return Runs(tuple(paths), runs)


def find_run_files(files: RunsLike | None) -> list[Path]:
    """Return the files that are meant, each once.

    Parameters
    ----------
    files : str, Path, sequence of these, Runs or None
        Files, folders (every CSV and Parquet file in them) or patterns. None means no file.

    Returns
    -------
    list of Path
        In the order given, sorted within each pattern.

    Raises
    ------
    NotFoundError
        If one of them names no file.
    """
    if files is None:
        return []
    if isinstance(files, Runs):
        return list(files.files)
    found: dict[Path, Path] = {}
    for each in [files] if isinstance(files, str | Path) else files:
        place = Path(each)
        if place.is_file():
            here = [place]
        elif place.is_dir():
            here = sorted(path for path in place.iterdir() if path.suffix.lower() in RUN_SUFFIXES)
        else:
            here = sorted(Path(name) for name in glob(str(each)))
        if not here:
            where = f"the folder {each} holds no" if place.is_dir() else f"{str(each)!r} names no"
            raise NotFoundError(f"{where} CSV or Parquet file (looked for from {Path.cwd()})", pattern=str(each))
        found |= {path.resolve(): path for path in here if path.resolve() not in found}
    return list(found.values())


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A model that was trained or calibrated. It may be given wherever a model is asked for.

    Attributes
    ----------
    folder : Path
        Where it lies.
    facts : dict
        What its making left: version, runs, errors.
    """

    folder: Path
    facts: dict[str, Any]

    @property
    def held_out(self) -> dict[str, Any]:
        """Errors on runs that a network had not seen, as `evaluate` gives them."""
        return dict(self.facts["held_out"])

    def _rows(self) -> dict[str, str]:
        facts = self.facts
        return {
            "version": facts["version"],
            "learned from": f"{facts['segments']:,} segments of 1 m of {runs_words(len(facts['runs']))}",
            "held-out error": f"{facts['held_out']['mean_relative_error']:.1%} of the energy of a metre in the mean",
            "turning": f"{facts['turn_j_per_rad']:.1f} J/rad beyond straight driving",
        }

    def __repr__(self) -> str:
        return f"<Model {self.folder}: held-out error {self.facts['held_out']['mean_relative_error']:.1%} a metre>"

    def __str__(self) -> str:
        return text_table(f"Model {self.folder}", self._rows())

    def _repr_html_(self) -> str:
        return html_table(f"Model {self.folder}", self._rows())


def train(
    ground: GroundLike,
    runs: RunsLike,
    *,
    out: str | Path,
    robot: RobotLike = None,
    architecture: str = "compact",
    start_from: str | Path | Model | None = None,
    epochs: int | None = None,
    seed: int = 0,
    charge: bool = False,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Model:
    """Train a model on measured runs.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap that the runs were driven on.
    runs : Runs, str, Path or sequence of these
        The runs, or their files.
    out : str or Path
        Folder for the model.
    robot : Robot, mapping, str, Path or None, optional
        The robot that drove.
    architecture : str, optional
        "compact", or "resnet18", the network of the paper.
    start_from : str, Path or Model, optional
        Model to fine-tune: "default", a folder, or "none" to train from random weights. By default the shipped network
        for "compact", "none" otherwise.
    epochs : int, optional
        Most passes over the data.
    seed : int, optional
        The same seed and data give the same weights.
    charge : bool, optional
        Whether charge times nominal voltage is learned instead of energy, for logs whose voltage is wrong.
    overwrite : bool, optional
        Whether a model that is there already is replaced.
    progress : callable, optional
        Called with the share done, 0..1.

    Returns
    -------
    Model
        Its errors are of runs that a network had not seen.

    Raises
    ------
    RunsError
        If the runs cannot be used.
    ConflictError
        If a model is there already, and `overwrite` is false.
    ModelError
        If `start_from` is no model.
    """
    from dataclasses import asdict

    from joulemap.model.energy.artifact import CONFIG_FILE
    from joulemap.model.errors import ConflictError
    from joulemap.model.training.measured_runs import train_on_runs
    from joulemap.service.models import start_folder

    folder = Path(out)
    if not overwrite and (folder / CONFIG_FILE).exists():
        raise ConflictError(f"{folder} holds a model already: choose another folder, or say overwrite=True")
    start = start_from if start_from is not None else ("default" if architecture == "compact" else "none")
    made = train_on_runs(
        ground_of(ground),
        robot_of(robot),
        find_run_files(runs),
        out=folder,
        architecture=architecture,
        start_from=start_folder(getattr(start, "folder", start)),
        epochs=epochs,
        seed=seed,
        charge=charge,
        progress=progress,
    )
    return Model(folder, asdict(made))


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """How well a model predicts measured runs.

    Attributes
    ----------
    document : dict
        All numbers, as `joulemap evaluate --json` writes them.
    """

    document: dict[str, Any]

    @property
    def mean_relative_error(self) -> float:
        """Mean over segments of 1 m of |predicted - measured| / measured."""
        return float(self.document["mean_relative_error"])

    @property
    def route_relative_error(self) -> float:
        """Mean over whole runs of |predicted - measured| / measured energy of the run."""
        return float(self.document["route_relative_error"])

    @property
    def warnings(self) -> list[str]:
        """Why these errors may not hold elsewhere."""
        return list(self.document["warnings"])

    def _rows(self) -> dict[str, str]:
        found = self.document
        rows = {
            "per metre": f"{found['mean_relative_error']:.1%} mean relative error of {found['segments']:,} segments",
            "whole runs": f"{found['route_relative_error']:.1%} of a run's energy",
            "bias": f"{found['bias_j']:+.2f} J per segment (measured - predicted)",
        }
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<Evaluation of {self.document['model']}: {self.mean_relative_error:.1%} a metre>"

    def __str__(self) -> str:
        return text_table(f"Evaluation of {self.document['model']}", self._rows())

    def _repr_html_(self) -> str:
        return html_table(f"Evaluation of {self.document['model']}", self._rows())


def evaluate(
    ground: GroundLike,
    runs: RunsLike,
    *,
    model: str | Path | Model = DEFAULT_MODEL,
    robot: RobotLike = None,
    charge: bool = False,
) -> Evaluation:
    """Say how well a model predicts measured runs.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap that the runs were driven on.
    runs : Runs, str, Path or sequence of these
        The runs, or their files.
    model : str, Path or Model, optional
        "default", "physics", a model's folder, or what `train` and `calibrate` return.
    robot : Robot, mapping, str, Path or None, optional
        The robot that drove.
    charge : bool, optional
        Whether charge times nominal voltage is compared instead of energy.

    Returns
    -------
    Evaluation
        Errors per metre and over whole runs.

    Raises
    ------
    RunsError
        If the runs cannot be used.
    ModelError
        If there is no such model.
    """
    from joulemap.model.training.evaluation import evaluate_on_runs
    from joulemap.service.models import find_predictor

    predictor = find_predictor(getattr(model, "folder", model))
    found = evaluate_on_runs(predictor, ground_of(ground), robot_of(robot), find_run_files(runs), charge=charge)
    return Evaluation(found)


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """What a model lacks on measured runs. It may be given wherever a model is asked for.

    Attributes
    ----------
    out : Path
        Folder of `report.json`, `report.html` and the calibrated model.
    report : dict
        The report, as in `report.json`.
    """

    out: Path
    report: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Folder of the calibrated model.

        Raises
        ------
        InputError
            If nothing was found, so that there is no calibrated model.
        """
        if self.report["model"]["after"] is None:
            raise InputError(f"nothing was found that the model lacks: {self.out} holds a report and no model")
        return self.out / CALIBRATED_FOLDER

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was found, each with name, coefficients, 95 % intervals and p-value; the strongest first."""
        return list(self.report["effects"])

    @property
    def report_html(self) -> Path:
        """The report for a browser."""
        return self.out / REPORT_HTML

    def _title(self) -> str:
        names = ", ".join(effect["name"] for effect in self.effects)
        return f"Calibration found {names}" if names else "Calibration found nothing that the model lacks"

    def _rows(self) -> dict[str, str]:
        error = self.report["error"]
        rows = {
            effect["name"]: f"p = {effect['p_value']:.2g}, {'used' if effect['in_plans'] else 'not used'} in plans"
            for effect in self.effects
        }
        rows["mean relative error"] = (
            f"{error['before']['mean_relative']:.1%} before, {error['after']['mean_relative']:.1%} after, of a metre"
        )
        return rows | {"report": str(self.report_html)}

    def __repr__(self) -> str:
        return f"<{self._title()}>"

    def __str__(self) -> str:
        return text_table(self._title(), self._rows())

    def _repr_html_(self) -> str:
        return html_table(self._title(), self._rows())


def calibrate(
    ground: GroundLike,
    runs: RunsLike,
    *,
    out: str | Path,
    model: str | Path | Model = DEFAULT_MODEL,
    robot: RobotLike = None,
    baseline_runs: RunsLike | None = None,
    test_runs: RunsLike | None = None,
    start: Point | None = None,
    goal: Point | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> CalibrationResult:
    """Find what a model lacks on measured runs, and write a model that has it.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap that the runs were driven on.
    runs : Runs, str, Path or sequence of these
        The runs, or their files.
    out : str or Path
        Folder for `report.json`, `report.html` and the calibrated model.
    model : str, Path or Model, optional
        The model to be calibrated.
    robot : Robot, mapping, str, Path or None, optional
        The robot that drove.
    baseline_runs : Runs, str, Path or sequence of these, optional
        Runs in which nothing new is at work. By default those that the model was trained on.
    test_runs : Runs, str, Path or sequence of these, optional
        Runs that have no part in the fit; the report has the error on them before and after.
    start, goal : sequence of float, optional
        World x, y [m] of a task whose routes before and after are compared.
    seed : int, optional
        Of the permutations: the same seed gives the same report.
    progress : callable, optional
        Called with the share done, 0..1.

    Returns
    -------
    CalibrationResult
        Effects, errors before and after, and the calibrated model.

    Raises
    ------
    RunsError
        If the runs cannot be used.
    ConflictError
        If `out` holds a calibrated model already: a model version is never changed.
    InputError
        If only one of `start` and `goal` is given.
    """
    from joulemap.model.runs.files import read_calibration_runs

    if (start is None) != (goal is None):
        raise InputError("give `start` and `goal`, or neither")
    heightmap, driven_by = ground_of(ground), robot_of(robot)
    tests = find_run_files(test_runs)
    kept = {file.resolve() for file in tests}
    files = [file for file in find_run_files(runs) if file.resolve() not in kept]
    read = read_calibration_runs(
        files, driven_by, crs=heightmap.frame.crs, base_files=find_run_files(baseline_runs), aside_files=tests
    )
    task = None if start is None or goal is None else ((start[0], start[1]), (goal[0], goal[1]))
    return calibrate_and_report(
        getattr(model, "folder", model),
        heightmap,
        driven_by,
        read,
        out=Path(out),
        task=task,
        seed=seed,
        progress=progress,
    )


def calibrate_and_report(
    model: str | Path,
    heightmap: Heightmap,
    robot: Robot,
    runs: CalibrationRuns,
    *,
    out: Path,
    task: Task | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> CalibrationResult:
    """Calibrate on runs that are read already, and write the report beside the model.

    Parameters
    ----------
    model : str or Path
        Name or folder of the model to be calibrated.
    heightmap : Heightmap
        The ground; level ground for runs without positions.
    robot : Robot
        The robot that drove.
    runs : CalibrationRuns
        What is learned from, compared with, and tested on.
    out : Path
        Folder for the report and the model.
    task : pair of points, optional
        Start and goal whose routes are compared.
    seed : int, optional
        Of the permutations.
    progress : callable, optional
        Called with the share done, 0..1.

    Returns
    -------
    CalibrationResult
        As `calibrate`.

    Raises
    ------
    RunsError, ConflictError, ModelError
        As `calibrate`.
    """
    from joulemap.service.loop.calibration import calibrate_on_runs
    from joulemap.service.loop.report_page import report_page

    made = calibrate_on_runs(model, heightmap, robot, runs, out=out, task=task, seed=seed, progress=progress)
    text = json.dumps(made.document, indent=2, allow_nan=False) + "\n"
    (out / REPORT_JSON).write_text(text, encoding="utf-8")
    (out / REPORT_HTML).write_text(report_page(made, heightmap), encoding="utf-8")
    return CalibrationResult(out, made.document)
