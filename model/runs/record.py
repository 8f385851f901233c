"""Baseline runs as a file: the residuals of the runs a model was made from, kept beside it for later calibrations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.features import Features, row_arrays
from joulemap.model.runs.residuals import Residuals

RECORD_FILE = "base_runs.npz"


def save_record(folder: str | Path, residuals: Residuals) -> None:
    """Write `base_runs.npz` into a model's folder."""
    rows = residuals.features
    arrays: dict[str, Any] = {name: getattr(rows, name) for name in row_arrays()}
    arrays |= {f"column:{key}": values for key, values in rows.columns.items()}
    arrays |= {f"word:{key}": values for key, values in rows.words.items()}
    arrays["measured"], arrays["said"] = residuals.measured, residuals.said
    about = {"robot": rows.robot.as_dict(), "unit_j": rows.unit_j, "names": rows.runs, "charge": residuals.charge}
    about["runs"] = residuals.runs
    np.savez_compressed(Path(folder) / RECORD_FILE, about=np.array(json.dumps(about)), **arrays)


def read_record(folder: str | Path) -> Residuals | None:
    """Read the runs a model was made from. Result: None where the folder has no record."""
    path = Path(folder) / RECORD_FILE
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
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
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(f"{path} is damaged: {error!r}") from error
