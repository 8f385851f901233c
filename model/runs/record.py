"""Baseline runs as a file: the residuals of the runs a model was made from, kept beside it for later calibrations."""

from __future__ import annotations

import hashlib
import json
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.features import Features, row_arrays
from joulemap.model.runs.residuals import Residuals

RECORD_FILE = "base_runs.npz"
_INSTEAD = "restore the file, train the model again, or name the baseline runs in the calibration"


def save_record(folder: str | Path, residuals: Residuals) -> str:
    """Write `base_runs.npz` into a model's folder. Result: its SHA-256."""
    rows = residuals.features
    arrays: dict[str, Any] = {name: getattr(rows, name) for name in row_arrays()}
    arrays |= {f"column:{key}": values for key, values in rows.columns.items()}
    arrays |= {f"word:{key}": values for key, values in rows.words.items()}
    arrays["measured"], arrays["said"] = residuals.measured, residuals.said
    about = {"robot": rows.robot.as_dict(), "unit_j": rows.unit_j, "names": rows.runs, "charge": residuals.charge}
    about["runs"] = residuals.runs
    path = Path(folder) / RECORD_FILE
    np.savez_compressed(path, about=np.array(json.dumps(about)), **arrays)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_record(folder: str | Path, *, kept: str | None = None) -> Residuals | None:
    """Read the runs a model was made from.

    `kept`: SHA-256 of the record that was written with the model. Result: None where the folder has no record, and none
    was written.
    """
    path = Path(folder) / RECORD_FILE
    if not path.is_file():
        if kept is None:
            return None
        raise ModelError(f"{path} is missing, the runs that this model was trained on: {_INSTEAD}", path=str(path))
    try:
        content = path.read_bytes()
        if kept not in (None, hashlib.sha256(content).hexdigest()):
            raise ModelError(f"{path} is damaged, or of another training than the model: {_INSTEAD}", path=str(path))
        with np.load(BytesIO(content), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        about = json.loads(str(arrays.pop("about")))
        columns = {k.removeprefix("column:"): arrays.pop(k) for k in list(arrays) if k.startswith("column:")}
        words = {k.removeprefix("word:"): arrays.pop(k) for k in list(arrays) if k.startswith("word:")}
        robot = Robot.from_mapping(about["robot"])
        if lacking := sorted({*row_arrays(), "measured", "said"} - set(arrays)):
            raise ModelError(
                f"{path} lacks {', '.join(lacking)}, which this version needs of the runs that a model was trained on: "
                "train the model again",
                path=str(path),
                lacking=lacking,
            )
        measured, said = arrays.pop("measured"), arrays.pop("said")
        rows = Features(
            robot=robot,
            **arrays,
            columns=columns,
            words=words,
            unit_j=float(about["unit_j"]),
            runs=tuple(about["names"]),
        )
        return Residuals(rows, measured, tuple(about["runs"]), bool(about["charge"]), said)
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, zlib.error) as error:
        raise ModelError(f"{path} is damaged: {error!r}") from error
