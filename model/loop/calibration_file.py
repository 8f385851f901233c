"""The file of a calibrated model: what a calibration adds to a base model. Immutable once written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from joulemap.model.errors import ConflictError, ModelError
from joulemap.model.loop.terms import Correction

CALIBRATION_FILE = "calibration.json"
FORMAT = 3


def save_calibrated(folder: str | Path, correction: Correction, base: Mapping[str, Any]) -> str:
    """Write `calibration.json` into a folder that has none.

    Parameters
    ----------
    folder : str or Path
        Of the calibrated model; it is made if needed.
    correction : Correction
        What is added to the base model.
    base : mapping
        What the base model is, and where.

    Returns
    -------
    str
        The version: the first 16 hex digits of the SHA-256 of the content.

    Raises
    ------
    ConflictError
        If there is a calibration already.
    """
    path = Path(folder) / CALIBRATION_FILE
    if path.exists():
        raise ConflictError(f"{path} is there already: a model version is never changed", path=str(path))
    content = {"format": FORMAT, "base": dict(base), **correction.as_dict()}
    version = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"version": version, **content}, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return version


def read_calibrated(folder: str | Path) -> tuple[Correction, dict[str, Any], str]:
    """Read `calibration.json` of a folder.

    Parameters
    ----------
    folder : str or Path
        Of the calibrated model.

    Returns
    -------
    tuple of (Correction, dict, str)
        The correction, the base model as given to `save_calibrated`, and the version.

    Raises
    ------
    ModelError
        If the file cannot be read, or was changed after it was written.
    """
    path = Path(folder) / CALIBRATION_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content.pop("version")
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise ModelError(f"{path} cannot be read: {error!r}") from error
    if (made := content.get("format")) != FORMAT:
        raise ModelError(
            f"{path} has format {made}, and this version of joulemap reads format {FORMAT}: calibrate again on the "
            "same runs",
            format=made,
            expected=FORMAT,
        )
    found = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    if found != version:
        raise ModelError(f"{path} is not the calibration {version} that was written", version=found, expected=version)
    return Correction.from_dict(content), dict(content["base"]), str(version)
