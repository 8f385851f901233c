"""A calibrated model: a base model, and the effects that measured runs showed it to lack. Immutable once written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.uncertainty import USUAL_SPREAD, Spread, segment_std
from joulemap.model.errors import ConflictError, ModelError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.drive import Drive, describe_segments, planned_drive
from joulemap.model.loop.effects import Term
from joulemap.model.loop.formulas import driven_heights
from joulemap.model.loop.words import effect_name
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

CALIBRATION_FILE = "calibration.json"
FORMAT = 1
_CHUNK = 400_000  # cells x headings described at a time
_OTHER_HEIGHTS = 0.05  # of a map: less is no news


@dataclass(frozen=True)
class Correction:
    """What a calibration adds to a base model.

    terms : everything on top of it. planner : per term, whether a planner knows what it depends on. charge : the base
    prediction's scale is unknown, so that the terms replace it. turn_j_per_rad : of turning in plans, beyond the
    robot's own. conditions : logged columns at which plans are made unless told otherwise (their means on the runs).
    evidence : the report's effects, JSON-able. spread : how far off the calibrated model was on held-out runs, whose
    fits did not know them: what is not explained and what the coefficients are in doubt. Its factor is that on
    `assumed_std`; None of a charge.
    """

    terms: tuple[Term, ...]
    planner: tuple[bool, ...]
    charge: bool = False
    turn_j_per_rad: float = 0.0
    conditions: Mapping[str, float] = field(default_factory=dict)
    evidence: Sequence[Mapping[str, Any]] = ()
    spread: Spread | None = None

    def predict(self, drive: Drive, *, planner_only: bool = False) -> FloatArray:
        """(n,) energy of every row [J, or A s]; without its log where only what a planner knows may be used."""
        total = np.zeros(len(drive)) if self.charge else drive.predicted.copy()
        for term, known in zip(self.terms, self.planner, strict=True):
            if known or not planner_only:
                total += term.energy(drive)
        return total

    def as_dict(self) -> dict[str, Any]:
        return {
            "terms": [t.as_dict() for t in self.terms],
            "planner": list(self.planner),
            "charge": self.charge,
            "turn_j_per_rad": self.turn_j_per_rad,
            "conditions": dict(self.conditions),
            "evidence": [dict(e) for e in self.evidence],
            "spread": None if self.spread is None else self.spread.as_dict(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Correction:
        """Raises ModelError where something is missing."""
        try:
            spread = values.get("spread")
            return cls(
                tuple(Term.from_dict(t) for t in values["terms"]),
                tuple(bool(p) for p in values["planner"]),
                bool(values["charge"]),
                float(values["turn_j_per_rad"]),
                dict(values["conditions"]),
                list(values["evidence"]),
                None if spread is None else Spread.from_dict(spread),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"a calibration is not complete: {error!r}") from error


def assumed_std(std_j: NDArray[Any] | None, traction_per_m: NDArray[Any], robot: Robot) -> NDArray[Any]:
    """Standard deviation [J] of 1 m segments before a calibration: the base model's, or a usual share of its price."""
    if std_j is not None:
        return std_j
    level = robot.hotel_per_m + robot.weight_n * robot.rolling_resistance
    return segment_std(robot.price_per_m(traction_per_m), USUAL_SPREAD, level, factor=1.0).astype(traction_per_m.dtype)


class CalibratedPredictor:
    """A base model with a correction, asked like any other model."""

    def __init__(self, base: Predictor, correction: Correction, *, name: str, version: str) -> None:
        self.base, self.correction, self.name, self.version = base, correction, name, version
        self.spread = correction.spread or base.spread

    def provenance(self) -> dict[str, Any]:
        """What the model is, JSON-able."""
        effects = [t.as_dict() for t in self.correction.terms]
        return {
            "name": self.name,
            "kind": "calibrated",
            "version": self.version,
            "base": self.base.provenance(),
            "effects": effects,
            "spread": self.spread.as_dict(),
        }

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Those of the base, effects that plans cannot contain, and those of heights that this map does not have."""
        found = list(self.base.warnings(heightmap, robot))
        for term, known in zip(self.correction.terms, self.correction.planner, strict=True):
            if not known:
                found.append(
                    f"plans do not contain the effect {effect_name(term.name)}: it depends on what only a log records"
                )
            elif term.settings.get("over") == "elevation":
                low, high = driven_heights(term.settings["knots"])
                heights = heightmap.heights[np.isfinite(heightmap.heights)]
                if (other := np.mean((heights < low) | (heights > high))) > _OTHER_HEIGHTS:
                    found.append(
                        f"the effect {effect_name(term.name)} is known at heights from {low:.1f} to {high:.1f} m: it "
                        f"adds nothing on the {other:.0%} of this map that lies at other heights"
                    )
        return found

    def robot_with_turning(self, robot: Robot) -> Robot:
        """The robot with what its turns were found to cost."""
        return replace(robot, turn_j_per_rad=max(robot.turn_j_per_rad + self.correction.turn_j_per_rad, 0.0))

    def segment_energy(self, segments: Segments, heightmap: Heightmap, robot: Robot) -> FloatArray:
        """(n,) predicted energy of measured segments [J, or A s] from all that is known of them; NaN where the map is
        unknown. The base model speaks of the declared robot: what a logged load costs is for the effects to say. Of a
        model of charge, joules are ampere seconds times the nominal voltage.
        """
        volts = robot.nominal_voltage_v if self.correction.charge and not segments.charge else 1.0
        segments = replace(segments, charge=segments.charge or self.correction.charge)
        traction = self.base.segment_traction(heightmap, robot, segments.x, segments.y, segments.heading_rad)
        drive, _ = describe_segments(segments, heightmap, robot, traction, with_stands=False)
        known = np.isfinite(traction) & np.isfinite(drive.grade)
        return np.where(known, volts * self.correction.predict(drive), np.nan)

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """(n,) [J/m] of straight 1 m segments at cruising speed, effects included; NaN where the map is unknown."""
        xs, ys, headings = (np.ascontiguousarray(a, float).ravel() for a in np.broadcast_arrays(x, y, heading_rad))
        traction = self.base.segment_traction(heightmap, robot, xs, ys, headings)
        return self._with_effects(heightmap, robot, xs, ys, headings, traction)

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray | None]:
        """`segment_traction`, and the standard deviation of each segment's energy [J]."""
        xs, ys, headings = (np.ascontiguousarray(a, float).ravel() for a in np.broadcast_arrays(x, y, heading_rad))
        traction, std = self.base.segment_traction_and_std(heightmap, robot, xs, ys, headings)
        std = self.std_of(std, traction, robot)
        return self._with_effects(heightmap, robot, xs, ys, headings, traction), std

    def std_of(self, std_j: NDArray[Any] | None, traction_per_m: NDArray[Any], robot: Robot) -> NDArray[Any] | None:
        """Standard deviation of 1 m segments [J]; std_j, traction_per_m : as the base model says."""
        if self.correction.spread is None:
            return std_j
        return assumed_std(std_j, traction_per_m, robot) * traction_per_m.dtype.type(self.correction.spread.factor)

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> NDArray[np.float32]:
        """(rows, cols, headings) float32 [J/m] at the cell centres of `frame`; NaN where the map is unknown."""
        return self.traction_and_std(heightmap, robot, frame, headings_rad)[0]

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """`traction_per_m`, and the standard deviation of a 1 m segment's energy [J]."""
        traction, std = self.base.traction_and_std(heightmap, robot, frame, headings_rad)
        std = self.std_of(std, traction, robot)
        x, y = frame.centres()
        rows = max(1, _CHUNK // (x.size * len(headings_rad)))
        for start in range(0, y.size, rows):
            part = traction[start : start + rows]
            cells = np.broadcast_arrays(x[None, :, None], y[start : start + rows, None, None], headings_rad)
            xs, ys, headings = (c.ravel() for c in cells)
            flat = self._with_effects(heightmap, robot, xs, ys, headings, part.ravel())
            traction[start : start + rows] = flat.reshape(part.shape)
        return traction, std

    def _with_effects(
        self,
        heightmap: Heightmap,
        robot: Robot,
        x: FloatArray,
        y: FloatArray,
        heading_rad: FloatArray,
        traction: NDArray[Any],
    ) -> FloatArray:
        """Traction whose price is the calibrated one; of a charge, ampere seconds times the nominal voltage.

        Where the effects leave less than nothing of the motion, the price says so as far as regeneration does.
        """
        drive = planned_drive(
            heightmap,
            robot,
            x,
            y,
            heading_rad,
            traction,
            self.correction.conditions,
            with_ground=any(term.reads_ground for term in self.correction.terms),
        )
        if self.correction.charge:
            drive = replace(drive, unit_j=robot.nominal_voltage_v)
        motion = drive.unit_j * (self.correction.predict(drive, planner_only=True) - drive.hotel_part)
        down = motion / robot.regeneration if robot.regeneration > 0 else np.minimum(np.asarray(traction, float), 0.0)
        return np.where(motion >= 0, motion, down)


def save_calibrated(folder: str | Path, correction: Correction, base: Mapping[str, Any]) -> str:
    """Write `calibration.json` into a folder that has none. base : what and where the base model is. Returns the
    version, the SHA-256 of the content (16 hex digits). Raises ConflictError where a calibration is there already.
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
    """(correction, base, version) of a folder. Raises ModelError where the file is broken or was changed."""
    path = Path(folder) / CALIBRATION_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content.pop("version")
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise ModelError(f"{path} cannot be read: {error!r}") from error
    found = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    if content.get("format") != FORMAT or found != version:
        raise ModelError(f"{path} is not the calibration {version} that was written", version=found, expected=version)
    return Correction.from_dict(content), dict(content["base"]), str(version)
