"""Models by name: the shipped ones, trained ones and calibrated ones, and what they know of a robot."""

from __future__ import annotations

import re
from pathlib import Path

from joulemap.model.energy.domain import Learned
from joulemap.model.energy.predictor import MODEL_NAMES, Predictor, load_predictor
from joulemap.model.errors import ModelError
from joulemap.model.loop.calibrated import CALIBRATION_FILE, CalibratedPredictor, read_calibrated
from joulemap.model.robot import Robot

DEFAULT_MODEL = "default"
CALIBRATED_FOLDER = "model"
"""Where a calibration leaves its model, beside its report."""
_MODEL_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def find_predictor(model: str | Path, *, models_dir: Path | None = None) -> Predictor:
    """The predictor called `model`: "physics", "default", or a trained one.

    With `models_dir` a trained model is an id inside that folder and nothing else (what a stranger may ask for);
    without, it is the path of a model's folder. Raises ModelError.
    """
    if models_dir is None or model in MODEL_NAMES:
        return load_model(model)
    trained = sorted(p.name for p in models_dir.iterdir() if p.is_dir()) if models_dir.is_dir() else []
    if not _MODEL_ID.fullmatch(str(model)) or str(model) not in trained:
        known = [*MODEL_NAMES, *trained]
        raise ModelError(
            f"there is no model {str(model)[:100]!r}: known are {', '.join(known)}", model=str(model)[:100], known=known
        )
    return load_model(models_dir / str(model))


def load_model(spec: str | Path) -> Predictor:
    """`load_predictor`, or the calibrated model of a folder. Raises ModelError."""
    if spec in MODEL_NAMES or not (Path(spec) / CALIBRATION_FILE).is_file():
        return load_predictor(spec)
    folder = Path(spec)
    correction, base, version = read_calibrated(folder)
    predictor = load_predictor(base["name"] if "name" in base else folder / str(base["folder"]))
    if predictor.provenance()["version"] != base["version"]:
        raise ModelError(
            f"{folder} was calibrated on {base}, but that model is now {predictor.provenance()['version']}",
            expected=base["version"],
        )
    return CalibratedPredictor(predictor, correction, name=model_name(folder), version=version)


def model_name(folder: Path) -> str:
    """What a calibrated model is called: its folder's name, and that of the folder it was written to beside it."""
    own = folder.resolve()
    return f"{own.parent.name}/{own.name}" if own.name == CALIBRATED_FOLDER else own.name


def planning_robot(predictor: Predictor, robot: Robot) -> Robot:
    """The robot with what the model found its turns to cost."""
    return predictor.robot_with_turning(robot) if isinstance(predictor, CalibratedPredictor | Learned) else robot
