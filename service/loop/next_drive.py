"""What to drive next, to separate effects that runs confound or to measure an effect more precisely."""

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
from joulemap.model.loop.words import effect_name
from joulemap.model.robot import Robot
from joulemap.model.runs.files import CalibrationRuns
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.models import load_model

USUAL_LENGTH_M = 200.0


@dataclass(frozen=True)
class NextDrive:
    """A drive that is suggested.

    Attributes
    ----------
    suggestion : Suggestion
        The route.
    rivals : list of str
        Effects that these runs cannot distinguish from the one it is for.
    length_m : float
        About how far to drive in all [m].
    placed : bool
        Whether its corners are places of a map; else only its shape counts.
    """

    suggestion: Suggestion
    rivals: list[str]
    length_m: float
    placed: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the drive as a JSON-able document: corners [m], length of one round [m], speeds [m/s]."""
        drive = self.suggestion
        return {
            "effect": drive.effect,
            "confounded_with": self.rivals,
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
    """Return the drive that separates an effect from those it is confounded with, or measures it more precisely.

    Parameters
    ----------
    found : Calibration
        What was found so far.
    predictor : Predictor
        The base model.
    heightmap : Heightmap
        Where to drive.
    robot : Robot
        That drives.
    placed : bool
        As in `CalibrationRuns`.
    effect : str, optional
        Key or name of a candidate effect. Without it the first confounded effect, or else the least certain one found.
    length_m : float
        About how far to drive in all [m].
    seed : int
        Of the routes that are tried.

    Returns
    -------
    NextDrive
        The best of a few hundred simple routes.

    Raises
    ------
    InputError
        If no effect was found and none is named, or if there is none of that name.
    InfeasibleError
        If no route fits on the map.
    """
    best = {c.name: found.trace.evidence.terms[v.term] for c, v in found.trace.ranking}
    best |= {e.term.name: e.term for e in found.effects}
    name = effect or next(iter(found.trace.confounded), None)
    lasting = [e for e in found.effects if not e.shadow and "runs" not in e.term.where]  # another day has another wind
    if name is None and lasting:
        name = max(lasting, key=lambda e: float(np.max((e.high - e.low) / np.abs(e.coefficients)))).term.name
    if name is None:
        raise InputError("no effect was found that lasts from day to day: name the `effect` to find out about")
    name = next((key for key in best if name in (key, effect_name(key))), name)
    if name not in best:
        raise InputError(
            f"these runs have no candidate effect {name!r}; the candidate effects are "
            f"{', '.join(sorted(map(effect_name, best)))}",
            name=name,
        )
    rivals = found.trace.confounded.get(name, [])
    others = [e.term for e in found.effects if e.term.name != name]

    def _traction(x: np.ndarray, y: np.ndarray, heading_rad: np.ndarray) -> np.ndarray:
        return predictor.segment_traction(heightmap, robot, x, y, heading_rad)

    suggestion = suggest_drive(
        found.residuals,
        best[name],
        [*(best[r] for r in rivals), *others],
        heightmap,
        robot,
        _traction,
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
    """Return the next drive after a calibration of which nothing is kept.

    Parameters
    ----------
    model : str or Path
        Name or folder of the base model.
    heightmap : Heightmap
        On which the runs were driven.
    robot : Robot
        That drove.
    runs : CalibrationRuns
        The runs so far.
    effect : str, optional
        As `next_drive`.
    length_m : float
        About how far to drive in all [m].
    seed : int
        Of the permutations and of the routes that are tried.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    NextDrive
        As `next_drive`.
    """
    predictor = load_model(model)
    measured, electric, _ = residuals_on(predictor, heightmap, robot, runs.segments)
    base = base_residuals(model, predictor, heightmap, robot, runs.baseline)
    found = calibrate(measured, electric=electric, base=base, seed=seed, progress=progress)
    return next_drive(
        found, predictor, heightmap, robot, placed=runs.placed, effect=effect, length_m=length_m, seed=seed
    )
