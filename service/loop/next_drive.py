"""What to drive next, to tell apart what runs confuse or to pin what they leave in doubt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError
from joulemap.model.loop.calibration import Calibration, calibrate
from joulemap.model.loop.residuals_of_runs import base_residuals, residuals_on
from joulemap.model.loop.suggest import Suggestion, suggest_drive
from joulemap.model.robot import Robot
from joulemap.model.runs.files import CalibrationRuns
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.models import load_model

USUAL_LENGTH_M = 200.0


@dataclass(frozen=True)
class NextDrive:
    """rivals : what these runs confuse the effect with. length_m : about as far as it is driven in all. placed :
    whether its corners are places of a map, and not only its shape.
    """

    suggestion: Suggestion
    rivals: list[str]
    length_m: float
    placed: bool

    def as_dict(self) -> dict[str, Any]:
        """JSON-able. points : corners [m]; length_m : of one round; expected_interval_share : see `Suggestion`."""
        drive = self.suggestion
        return {
            "effect": drive.effect,
            "tells_from": self.rivals,
            "kind": drive.kind,
            "placed": self.placed,
            "points": [[round(float(x), 2), round(float(y), 2)] for x, y in drive.points],
            "speeds_mps": list(drive.speeds),
            "length_m": drive.length_m,
            "total_length_m": self.length_m,
            "expected_interval_share": drive.shrinkage,
        }


def next_drive(
    found: Calibration,
    predictor: Predictor,
    heightmap: Heightmap,
    robot: Robot,
    *,
    placed: bool = True,
    effect: str | None = None,
    length_m: float = USUAL_LENGTH_M,
    seed: int = 0,
) -> NextDrive:
    """The drive that tells an effect from what a calibration confuses it with, or pins its coefficient.

    placed : as `CalibrationRuns`. effect : a candidate's name; the first confounded one, or the least certain one
    found, unless given. Raises InputError where nothing was found and no effect is named, InfeasibleError where no
    route fits.
    """
    best = {c.name: found.trace.evidence.terms[v.term] for c, v in found.trace.ranking}
    best |= {e.term.name: e.term for e in found.effects}
    name = effect or next(iter(found.trace.confounded), None)
    lasting = [e for e in found.effects if not e.shadow and "runs" not in e.term.where]  # another day has another wind
    if name is None and lasting:
        name = max(lasting, key=lambda e: float(np.max((e.high - e.low) / np.abs(e.coefficients)))).term.name
    if name is None:
        raise InputError(
            "these runs show nothing that the model lacks on any day: name the effect that you are in doubt about"
        )
    if name not in best:
        raise InputError(
            f"there is no candidate {name!r} on these runs; there are {', '.join(sorted(best))}", name=name
        )
    rivals = found.trace.confounded.get(name, [])
    others = [e.term for e in found.effects if e.term.name != name]

    def traction(x: np.ndarray, y: np.ndarray, heading_rad: np.ndarray) -> np.ndarray:
        return predictor.segment_traction(heightmap, robot, x, y, heading_rad)

    suggestion = suggest_drive(
        found.residuals,
        best[name],
        [*(best[r] for r in rivals), *others],
        heightmap,
        robot,
        traction,
        length_m=length_m,
        seed=seed,
    )
    return NextDrive(suggestion, rivals, length_m, placed)


def suggest_next_drive(
    model: str | Path,
    heightmap: Heightmap,
    robot: Robot,
    runs: CalibrationRuns,
    *,
    effect: str | None = None,
    length_m: float = USUAL_LENGTH_M,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> NextDrive:
    """`next_drive` after a calibration of which nothing is kept."""
    predictor = load_model(model)
    measured, electric, _ = residuals_on(predictor, heightmap, robot, runs.segments)
    base = base_residuals(model, predictor, heightmap, robot, runs.base)
    found = calibrate(measured, electric=electric, base=base, seed=seed, progress=progress)
    return next_drive(
        found, predictor, heightmap, robot, placed=runs.placed, effect=effect, length_m=length_m, seed=seed
    )
