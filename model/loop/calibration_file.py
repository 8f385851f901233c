"""The file of a calibrated model: what a calibration adds to a base model. Immutable once written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ConflictError, ModelError
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms import form_from_dict
from joulemap.model.loop.mixture import Mixture
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Drives

CALIBRATION_FILE = "calibration.json"
FORMAT = 4
READABLE = (3, FORMAT)
"""Format 3 has one prediction in plans in place of the mean of several."""


def save_calibrated(folder: str | Path, correction: Correction, base: Mapping[str, Any]) -> str:
    """Write `calibration.json` into a folder that has none.

    Result: the version: the first 16 hex digits of the SHA-256 of the content. Raises ConflictError if there is a
    calibration already.
    """
    path = Path(folder) / CALIBRATION_FILE
    if path.exists():
        raise ConflictError(f"{path} is there already: a model version is never changed", path=str(path))
    content = {"format": FORMAT, "base": dict(base), **_written(correction)}
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
    if (made := content.get("format")) not in READABLE:
        raise ModelError(
            f"{path} has format {made}, and this version of joulemap reads formats {READABLE[0]} and {FORMAT}: "
            "calibrate again on the same runs",
            format=made,
            expected=FORMAT,
        )
    found = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    if found != version:
        raise ModelError(f"{path} is not the calibration {version} that was written", version=found, expected=version)
    return _read(content), dict(content["base"]), str(version)


def _written(correction: Correction) -> dict[str, Any]:
    return {
        "terms": correction.effects,
        "planner_terms": [t.as_dict() for t in correction.planner_terms],
        "ranges": {key: list(ends) for key, ends in correction.ranges.items()},
        "drives": asdict(correction.drives),
        "first_base": None if correction.first_base is None else correction.first_base.as_dict(),
        "charge": correction.charge,
        "turn_j_per_rad": correction.turn_j_per_rad,
        "conditions": dict(correction.conditions),
        "evidence": [dict(e) for e in correction.evidence],
        "spread": None if correction.spread is None else correction.spread.as_dict(),
        "scale": correction.scale,
        "planner_scale": correction.planner_scale,
        "mixture": None if correction.mixture is None else correction.mixture.as_dict(),
        "reliability": None if correction.reliability is None else dict(correction.reliability),
        "drive_prior": None if correction.drive_prior is None else dict(correction.drive_prior),
        **({"turn_by_kind": dict(correction.turn_by_kind)} if correction.turn_by_kind else {}),
    }


def _read(values: Mapping[str, Any]) -> Correction:
    try:
        return Correction(
            tuple(map(_term, values["terms"])),
            tuple(map(_term, values["planner_terms"])),
            {key: (float(low), float(high)) for key, (low, high) in values["ranges"].items()},
            Drives(**values["drives"]),
            None if values["first_base"] is None else _term(values["first_base"]),
            bool(values["charge"]),
            float(values["turn_j_per_rad"]),
            dict(values["conditions"]),
            list(values["evidence"]),
            None if values["spread"] is None else Spread.from_dict(values["spread"]),
            float(values.get("scale", 1.0)),
            float(values.get("planner_scale", 1.0)),
            _mixture(values),
            values.get("reliability"),
            values.get("drive_prior"),
            {name: float(turn) for name, turn in values.get("turn_by_kind", {}).items()},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"a calibration is not complete: {error!r}") from error


def _mixture(values: Mapping[str, Any]) -> Mixture | None:
    if values.get("alone"):  # of format 3: the terms of plans are a simple model
        (term,) = map(_term, values["planner_terms"])
        name = "constant" if len(term.coefficients) == 1 else "least_squares"
        return Mixture({name: 1.0}, {name: term})
    if not (found := values.get("mixture")):
        return None
    simple = {name: _term(term) for name, term in found["simple"].items()}
    scale = None if found["scale"] is None else _term(found["scale"])
    return Mixture({name: float(share) for name, share in found["shares"].items()}, simple, scale)


def _term(values: Mapping[str, Any]) -> Term:
    form = form_from_dict({k: v for k, v in values.items() if k not in ("name", "coefficients")})
    return Term(form, tuple(float(c) for c in values["coefficients"]))
