"""The file of a calibrated model: what a calibration adds to a base model. Immutable once written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ConflictError, ModelError
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms import form_from_dict
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Drives

CALIBRATION_FILE = "calibration.json"
FORMAT = 3


def save_calibrated(folder: str | Path, correction: Correction, base: Mapping[str, Any]) -> str:
    """Write `calibration.json` into a folder that has none.

    Result: the version: the first 16 hex digits of the SHA-256 of the content. Raises ConflictError if there is a
    calibration already.
    """
    path = Path(folder) / CALIBRATION_FILE
    if path.exists():
        raise ConflictError(f"{path} is there already: a model version is never changed", path=str(path))
    content = json.loads(json.dumps({"format": FORMAT, "base": dict(base), **vars(correction)}, default=_plain))
    version = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"version": version, **content}, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return version


def read_calibrated(folder: str | Path) -> tuple[Correction, dict[str, Any], str]:
    """Read `calibration.json` of a folder.

    Result: the correction, the base model as given to `save_calibrated`, and the version.
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
    return _read(content), dict(content["base"]), str(version)


def _plain(value: Any) -> Any:
    """A part of a correction that JSON does not know."""
    if isinstance(value, Mapping):
        return dict(value)
    return value.as_dict() if hasattr(value, "as_dict") else asdict(value)


def _read(values: Mapping[str, Any]) -> Correction:
    first, spread = values.get("first_base"), values.get("spread")
    try:
        made: dict[str, Any] = {
            "terms": tuple(map(_term, values["terms"])),
            "planner_terms": tuple(map(_term, values["planner_terms"])),
            "ranges": {key: (float(low), float(high)) for key, (low, high) in values["ranges"].items()},
            "drives": Drives(**values["drives"]),
            "first_base": None if first is None else _term(first),
            "heightmaps": tuple(values.get("heightmaps", ())),
            "spread": None if spread is None else Spread.from_dict(spread),
        }
        known = (field.name for field in fields(Correction))
        return Correction(**{name: values[name] for name in known if name in values} | made)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"a calibration is not complete: {error!r}") from error


def _term(values: Mapping[str, Any]) -> Term:
    form = form_from_dict({k: v for k, v in values.items() if k not in ("name", "coefficients")})
    return Term(form, tuple(float(c) for c in values["coefficients"]))
