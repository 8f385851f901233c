"""Models for a Python user: trained on measured runs, and evaluated on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from joulemap.model.energy.architectures import DEFAULT_ARCHITECTURE
from joulemap.model.energy.own_model import Formula, OwnModel, PredictsFromHeights
from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import ConflictError, InputError
from joulemap.service.library.heightmaps import GroundLike, RobotLike
from joulemap.service.library.run_files import RunsLike
from joulemap.service.library.shown import Shown
from joulemap.service.library.sites import SiteLike, sites_given
from joulemap.service.models import DEFAULT_MODEL, find_predictor
from joulemap.service.questions.asking import asks
from joulemap.service.questions.training import EvaluationOptions, TrainingOptions
from joulemap.service.words import runs_words, turning_words


class InFolder(Protocol):
    """Something that has a model in a folder."""

    @property
    def folder(self) -> Path:
        """Folder of the model."""


ModelLike = str | Path | InFolder | Formula | PredictsFromHeights
"""The name of a model ("default", "physics"), its folder, what `train` and `calibrate` return, or a model of one's own:
a formula, or an object that predicts from heights."""


def predictor_of(model: ModelLike) -> Predictor:
    """Return the predictor of the model that is meant.

    Raises ModelError if there is no such model, InputError if it is none.
    """
    if isinstance(model, str | Path):
        return find_predictor(model)
    if isinstance(folder := getattr(model, "folder", None), str | Path):
        return find_predictor(folder)
    if callable(model) or isinstance(model, PredictsFromHeights):
        return OwnModel(model)
    raise InputError(
        f"a model is a name, a folder, what `train` and `calibrate` return, a function of slopes, roughness and speed, "
        f"or an object with `predict`; got {type(model).__name__}"
    )


@dataclass(frozen=True, eq=False, repr=False)
class Model(Shown):
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

    @property
    def warnings(self) -> list[str]:
        """What the training warned of."""
        return list(self.facts.get("warnings", []))

    def _title(self) -> str:
        return f"Model {self.folder}"

    def _rows(self) -> dict[str, str]:
        facts = self.facts
        return {
            "version": facts["version"],
            "learned from": f"{facts['segments']:,} segments of 1 m of {runs_words(len(facts['runs']))}",
            "held-out error": f"{facts['held_out']['mean_relative_error']:.1%} of the energy of a metre in the mean",
            "turning": turning_words(facts),
        } | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<Model {self.folder}: held-out error {self.facts['held_out']['mean_relative_error']:.1%} a metre>"


@asks(TrainingOptions)
def train(
    ground: GroundLike | None = None,
    runs: RunsLike | None = None,
    *,
    out: str | Path,
    sites: Sequence[SiteLike] | None = None,
    campaign: str | Path | None = None,
    robot: RobotLike = None,
    wanted: TrainingOptions,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Model:
    """Train a model on measured runs.

    Parameters
    ----------
    ground : Heightmap, str or Path, optional
        The heightmap that the runs were driven on. Not with `sites` or `campaign`. Runs with a speed or a distance and
        no positions need none: rolling and climbing are learned, and not the shape of the ground.
    out : str or Path
        Folder for the model.
    sites : sequence of tuple, optional
        Several heightmaps and the runs on each, like [("a.tif", "a/*.csv"), ("b.tif", "b.csv", "other.toml")]: the
        third item is the robot, where another one drove.
    overwrite : bool, optional
        Whether a model that is there already is replaced.

    Returns
    -------
    Model
        Its errors are of runs that a network had not seen.

    Raises
    ------
    InputError
        If none or several of `ground` with `runs`, `sites` and `campaign` are given.
    RunsError
        If the runs cannot be used.
    ConflictError
        If a model is there already, and `overwrite` is false.
    ModelError
        If `start_from` is no model.
    """
    from dataclasses import asdict

    from joulemap.model.energy.artifact import CONFIG_FILE
    from joulemap.model.training.measured_runs import Learner, train_on_sites
    from joulemap.service.models import start_folder

    folder = Path(out)
    if not overwrite and (folder / CONFIG_FILE).exists():
        raise ConflictError(f"{folder} holds a model already: choose another folder, or say overwrite=True")
    usual = "default" if wanted.architecture == DEFAULT_ARCHITECTURE else "none"
    learner = Learner(
        **wanted.model_dump(include={"architecture", "patch_size", "epochs"}),
        seed=wanted.seed or 0,
        start_from=start_folder(wanted.start_from or usual),
        backbone=None if wanted.backbone is None else Path(wanted.backbone),
    )
    made = train_on_sites(
        sites_given(ground, runs, sites=sites, campaign=campaign, robot=robot),
        learner,
        out=folder,
        charge=wanted.charge,
        resume=wanted.resume,
        progress=progress,
    )
    return Model(folder, asdict(made))


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Shown):
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

    def _title(self) -> str:
        return f"Evaluation of {self.document['model']}"

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


@asks(EvaluationOptions)
def evaluate(
    ground: GroundLike | None = None,
    runs: RunsLike | None = None,
    *,
    sites: Sequence[SiteLike] | None = None,
    campaign: str | Path | None = None,
    model: ModelLike = DEFAULT_MODEL,
    robot: RobotLike = None,
    wanted: EvaluationOptions,
) -> Evaluation:
    """Say how well a model predicts measured runs.

    Parameters
    ----------
    ground : Heightmap, str or Path, optional
        The heightmap that the runs were driven on. Not with `sites` or `campaign`.
    sites : sequence of tuple, optional
        Several heightmaps and the runs on each, as in `train`.
    model : str, Path, Model, callable or object with `predict`, optional
        As of `costmap`.

    Returns
    -------
    Evaluation
        Errors per metre and over whole runs.

    Raises
    ------
    InputError
        If none or several of `ground` with `runs`, `sites` and `campaign` are given.
    RunsError
        If the runs cannot be used.
    ModelError
        If there is no such model.
    """
    from joulemap.model.training.evaluation import evaluate_on_sites

    predictor = predictor_of(model)
    given = sites_given(ground, runs, sites=sites, campaign=campaign, robot=robot)
    return Evaluation(evaluate_on_sites(predictor, given, charge=wanted.charge))
