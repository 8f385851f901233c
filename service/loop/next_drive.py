"""What to drive next, to separate effects that runs confound or to measure an effect more precisely."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError
from joulemap.model.loop.calibrate import Calibration, Effect, calibrate
from joulemap.model.loop.forms import Form
from joulemap.model.loop.suggest import Suggestion, suggest_drive
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.measured import measure
from joulemap.service.models import load_model

FloatArray = NDArray[np.float64]

USUAL_LENGTH_M = 200.0


@dataclass(frozen=True)
class NextDrive:
    """A drive that is suggested.

    Attributes
    ----------
    suggestion : Suggestion
        The route.
    effect : Form
        Which it measures.
    rivals : tuple of Form
        Which these runs cannot distinguish from it.
    length_m : float
        About how far to drive in all [m].
    placed : bool
        Whether its corners are places of a map; else only its shape counts.
    crs : str or None
        Coordinate reference system of that map.
    """

    suggestion: Suggestion
    effect: Form
    rivals: tuple[Form, ...]
    length_m: float
    placed: bool
    crs: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the drive as a JSON-able document: corners [m], length of one round [m], speeds [m/s]."""
        drive = self.suggestion
        return {
            "effect": self.effect.name,
            "label": self.effect.title,
            "confounded_with": [form.name for form in self.rivals],
            "confounded_labels": [form.title for form in self.rivals],
            "kind": drive.kind,
            "placed": self.placed,
            "crs": self.crs,
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

    Result: the best of a few hundred simple routes.
    """
    forms = {key: alone.candidate.form for key, (alone, _) in found.fitted.selection.by_name.items()}
    forms |= {e.term.form.name: e.term.form for e in found.effects}
    name = next((key for key, form in forms.items() if effect in (key, form.title)), effect) or _least_certain(found)
    if name not in forms:
        raise InputError(
            f"these runs have no candidate effect {name!r}; the candidate effects are "
            f"{', '.join(sorted({form.title for form in forms.values()}))}",
            name=name,
        )
    names = found.rivals.get(name) or [key for key, others in found.rivals.items() if name in others]
    rivals = tuple(forms[rival] for rival in names)
    beside = [e.term.form for e in found.effects if e.term.form.name not in (name, *names)]

    def _traction(x: np.ndarray, y: np.ndarray, heading_rad: np.ndarray) -> np.ndarray:
        return predictor.segment_traction(heightmap, robot, x, y, heading_rad)

    suggestion = suggest_drive(
        found.residuals,
        forms[name],
        [*rivals, *beside],
        heightmap,
        robot,
        _traction,
        length_m=length_m,
        seed=seed,
    )
    return NextDrive(suggestion, forms[name], rivals, length_m, placed, heightmap.frame.crs if placed else None)


def _least_certain(found: Calibration) -> str:
    """Name of the effect to drive for where none is asked for."""
    if found.rivals:
        return next(iter(found.rivals))
    # no choice of a route changes the weather, the load or a fault of the log
    shown = [e for e in found.effects if e.term.form.on_map and not e.term.form.weather]
    if not shown:
        kind = "that a route can show" if found.effects else "to measure"
        raise InputError(f"no effect was found {kind}: name the `effect` to find out about")
    return max(shown, key=lambda e: float(np.max((e.high - e.low) / _sizes(e)))).term.form.name


def _sizes(effect: Effect) -> FloatArray:
    """Magnitudes of the coefficients; of a curve or field, whose values mean something together only, the largest."""
    sizes = np.abs(effect.term.coefficients)
    return np.maximum(sizes if sizes.size == 1 else np.full(sizes.size, sizes.max()), 1e-12)


def suggest_next_drive(
    model: str | Path,
    runs: CalibrationRuns,
    *,
    effect: str | None = None,
    length_m: float = USUAL_LENGTH_M,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> NextDrive:
    """Return the next drive after a calibration of which nothing is kept."""
    predictor = load_model(model)
    measured = measure(model, predictor, runs)
    found = calibrate(
        measured.residuals,
        electric=measured.electric,
        base=measured.baseline,
        cross_validate=False,
        progress=progress,
    )
    return next_drive(
        found,
        predictor,
        measured.main.heightmap,
        runs.robot,
        placed=runs.placed,
        effect=effect,
        length_m=length_m,
        seed=seed,
    )
