"""Models by name: shipped, trained and calibrated ones, and what they know about a robot."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from joulemap.model.energy.predictor import MODEL_NAMES, SHIPPED_WEIGHTS, Predictor, load_predictor
from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.terrain.windows import Ground

DEFAULT_MODEL = "default"
CALIBRATED_FOLDER = "model"
"""Where a calibration leaves its model, beside its report."""
_MODEL_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@runtime_checkable
class _KnowsTurning(Protocol):
    """A network or a calibrated model that may have learned what turning costs."""

    def robot_with_turning(self, robot: Robot, kinds: Mapping[str, float] | None = None) -> Robot: ...


def find_predictor(model: str | Path, *, models_dir: Path | None = None, hidden: Collection[str] = ()) -> Predictor:
    """Return the predictor of this name."""
    if models_dir is None or model in MODEL_NAMES:
        return load_model(model)
    trained = sorted(p.name for p in models_dir.iterdir() if p.is_dir()) if models_dir.is_dir() else []
    trained = [name for name in trained if name not in hidden]
    if not _MODEL_ID.fullmatch(str(model)) or str(model) not in trained:
        known = [*MODEL_NAMES, *trained]
        raise ModelError(
            f"there is no model {str(model)[:100]!r}: known are {', '.join(known)}", model=str(model)[:100], known=known
        )
    return load_model(models_dir / str(model))


def load_model(spec: str | Path) -> Predictor:
    """Return a shipped model, or the trained or calibrated model of a folder."""
    if spec in MODEL_NAMES:
        return load_predictor(spec)
    from joulemap.model.loop.calibrated import CalibratedPredictor  # loads slowly
    from joulemap.model.loop.calibration_file import CALIBRATION_FILE, read_calibrated

    if not (Path(spec) / CALIBRATION_FILE).is_file():
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
    """Return the name of a calibrated model: that of its folder, or of the report's folder and its own."""
    own = folder.resolve()
    return f"{own.parent.name}/{own.name}" if own.name == CALIBRATED_FOLDER else own.name


def planning_robot(predictor: Predictor, robot: Robot, ground: Ground | None = None) -> Robot:
    """Return the robot with the energy of turning that the model learned, on the kinds of ground of a map."""
    if not isinstance(predictor, _KnowsTurning):
        return robot
    return predictor.robot_with_turning(robot, None if ground is None else ground.layers.kind_shares(ground.frame))


def start_folder(name: str | Path) -> Path | None:
    """Return the folder of the model that a training starts from.

    Result: None for "none": training starts from random weights.
    """
    if name == "none":
        return None
    return Path(str(SHIPPED_WEIGHTS)) if name == "default" else Path(name)
