"""A calibrated model: a base model, and what measured runs showed it to lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.prediction import Prediction, assumed_std, predict_segments, std_of_segments
from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.describe import describe_segments, planned_features
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.words import quantity_name, quantity_value
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers.kinds import library

if TYPE_CHECKING:  # every plan loads this module, and few need all forms
    from joulemap.model.loop.correction import Correction

_CHUNK = 400_000  # cells x headings described at a time
_PLACES = 2000  # of a map, for warnings
_HEADINGS = np.arange(4) * 0.5 * np.pi
_OTHER_GROUND = 0.05  # of a map beyond a range: less is not worth a warning


class CalibratedPredictor(Predictor):
    """A base model with a correction, used like any other model."""

    def __init__(self, base: Predictor, correction: Correction, *, name: str, version: str) -> None:
        self.base, self.correction, self.version, self._name = base, correction, version, name

    @property
    def name(self) -> str:
        return self._name

    @property
    def learned_kinds(self) -> frozenset[str]:
        """Kinds of ground, by name, whose cost it learned of runs."""
        return frozenset(self.correction.kinds)

    @property
    def spread(self) -> Spread:
        return self.correction.spread or self.base.spread

    def provenance(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "calibrated",
            "version": self.version,
            "base": self.base.provenance(),
            "effects": self.correction.effects,
            "spread": self.spread.as_dict(),
            "drive_prior": self.correction.drive_prior,
            "heightmaps": list(self.correction.heightmaps),
        }

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        found = list(self.base.warnings(heightmap, self.robot_of_base(robot)))
        declared, of_runs = robot.drivetrain_efficiency, self.correction.drivetrain_efficiency
        if of_runs is not None and declared not in (0.0, of_runs):
            then = f"declared {of_runs:g}" if of_runs else "declared none"
            found.append(
                f"the drivetrain efficiency of {declared:g} is not used: the robot of the calibration runs {then}, and "
                "the runs say what climbs cost; calibrate again with this robot's file if it is the same robot"
            )
        found += [
            f"plans do not contain the effect {title}: it depends on what only a log records"
            for title in self.correction.only_in_logs
        ]
        used = {"column:payload", *(key for term in self.correction.planner_terms for key in term.form.covariates)}
        means = {f"column:{key}": value for key, value in self.correction.conditions.items() if value != 0.0}
        if means := {key: value for key, value in means.items() if key in used}:
            said = (f"{quantity_name(key)} {quantity_value(key, value)}" for key, value in means.items())
            found.append(f"plans are made at the means of the calibration runs: {', '.join(said)}")
        found += self._kinds_unlike(heightmap)
        if self.correction.ranges:
            rows = self._on_map(heightmap, robot)
            for name, share in self.correction.beyond(rows).items():
                low, high = self.correction.ranges[name]
                driven = f"{quantity_value(name, low)} to {quantity_value(name, high)}"
                if name == "speed":
                    found.append(
                        f"the robot's speed of {robot.speed_mps:g} m/s is outside the {driven} of the calibration "
                        "runs: what depends on speed has the value at the nearest of these"
                    )
                elif share > _OTHER_GROUND:
                    follow = name in self.correction.of_laws
                    found.append(
                        f"{share:.0%} of this map has a {quantity_name(name)} outside the {driven} of the calibration "
                        "runs: there the effects "
                        + ("follow a law that no run has shown there" if follow else "have their value at the border")
                    )
        return found

    def robot_of_base(self, robot: Robot) -> Robot:
        """Return the robot with the drivetrain that the base model had when its errors were measured."""
        known = self.correction.drivetrain_efficiency
        return robot if known is None else replace(robot, drivetrain_efficiency=known)

    def _kinds_unlike(self, heightmap: Heightmap) -> list[str]:
        """Warnings of ground that the runs do not show, of a model that learned of kinds of ground."""
        learned, there = self.correction.kinds, {kind.name for kind in heightmap.layers.kinds if not kind.blocked}
        if not learned:
            return []
        if not there:
            return [
                f"the model knows what {', '.join(learned)} cost, and the map has no layer of kinds of ground: it "
                "costs the mean of what was driven"
            ]
        if new := sorted(there - set(learned)):
            return [f"no run was driven on {', '.join(new)}: the cost is that of the legend, beside what was driven"]
        return []

    def _on_kinds(
        self, heightmap: Heightmap, robot: Robot, traction: NDArray[Any], x: ArrayLike, y: ArrayLike
    ) -> NDArray[Any]:
        """Base traction, with the difference of the default of a kind that no run shows from the mean one of others."""
        layers, learned = heightmap.layers, self.correction.kinds
        if not layers.kinds:
            return traction
        default = {kind.name: kind.resistance(robot) for kind in (*library().values(), *layers.kinds)}
        driven = [(share, at) for name, share in learned.items() if (at := default.get(name)) is not None]
        if learned and not driven:  # nobody knows how they differ
            return traction
        usual = robot.rolling_resistance
        if driven:
            usual = sum(share * at for share, at in driven) / sum(share for share, _ in driven)
        new = [usual if k.name in learned else default[k.name] for k in layers.kinds]
        more = [0.0 if at is None else at - usual for at in new]
        return traction + (robot.weight_n * np.array([*more, 0.0])[layers.kind_at(x, y)]).astype(traction.dtype)

    def _on_map(self, heightmap: Heightmap, robot: Robot) -> Features:
        """Features of a few thousand places of a map, in four headings."""
        frame = heightmap.frame
        x, y = frame.centres()
        step = max(1, int(np.sqrt(x.size * y.size / _PLACES)))
        xs, ys, headings = (
            c.ravel() for c in np.broadcast_arrays(x[None, ::step, None], y[::step, None, None], _HEADINGS)
        )
        rows = planned_features(
            heightmap, robot, xs, ys, headings, np.zeros(xs.size), self.correction.conditions, with_ground=True
        )
        return rows.take(np.isfinite(rows.grade))

    def robot_with_turning(self, robot: Robot, kinds: Mapping[str, float] | None = None) -> Robot:
        """Return the robot with the cost of turning that was found, on a map with these shares of kinds of ground."""
        learned = getattr(self.base, "robot_with_turning", None)  # of a network, which a calibration adds to
        known = robot if learned is None else learned(robot)
        more = sum(share * self.correction.turn_by_kind.get(kind, 0.0) for kind, share in (kinds or {}).items())
        return replace(known, turn_j_per_rad=max(known.turn_j_per_rad + self.correction.turn_j_per_rad + more, 0.0))

    def predict_segments(self, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction:
        """Predict measured segments from everything that their log says.

        Result: energy [J], or charge [A s] of segments of charge; NaN where the map is unknown. A model of charge gives
        joules as ampere seconds times the nominal voltage.
        """
        volts = robot.nominal_voltage_v if self.correction.charge and not segments.charge else 1.0
        segments = replace(segments, charge=segments.charge or self.correction.charge)
        said = predict_segments(self.base, heightmap.bare, self.robot_of_base(robot), segments)
        rows, _ = describe_segments(segments, heightmap, robot, said.traction_per_m, with_stationary=False)
        known = np.isfinite(said.energy_j) & np.isfinite(rows.grade)
        beyond = said.energy_j - rows.predicted
        energy = self._energy(replace(rows, drives=self.correction.drives), beyond, planned=False)
        std = said.std_j
        if self.correction.spread is not None:
            std = std_of_segments(said, robot, segments) * self.correction.spread.factor
        return Prediction(np.where(known, volts * energy, np.nan), std, said.traction_per_m)

    def _energy(self, rows: Features, beyond: FloatArray, *, planned: bool) -> FloatArray:
        """(n,) energy of rows; `beyond` is what the base model predicts beside ground and idle power."""
        correction = self.correction
        start = np.zeros(len(rows)) if correction.charge else rows.predicted + beyond
        scale = correction.planner_scale if planned else correction.scale
        return scale * (start + correction.added_energy(rows, planned=planned))

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray | None]:
        xs, ys, headings = (np.ascontiguousarray(a, float).ravel() for a in np.broadcast_arrays(x, y, heading_rad))
        base = self.robot_of_base(robot)
        traction, std = self.base.segment_traction_and_std(heightmap.bare, base, xs, ys, headings)
        traction, std = self._on_kinds(heightmap, robot, traction, xs, ys), self._std(std, traction, robot)
        return self._with_effects(heightmap, robot, xs, ys, headings, traction), std

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        traction, std = self.base.traction_and_std(heightmap.bare, self.robot_of_base(robot), frame, headings_rad)
        std = self._std(std, traction, robot)
        x, y = frame.centres()
        traction = self._on_kinds(heightmap, robot, traction, x[None, :, None], y[:, None, None])
        rows = max(1, _CHUNK // (x.size * len(headings_rad)))
        for start in range(0, y.size, rows):
            part = traction[start : start + rows]
            cells = np.broadcast_arrays(x[None, :, None], y[start : start + rows, None, None], headings_rad)
            xs, ys, headings = (c.ravel() for c in cells)
            flat = self._with_effects(heightmap, robot, xs, ys, headings, part.ravel())
            traction[start : start + rows] = flat.reshape(part.shape)
        return traction, std

    def _std(self, std_j: NDArray[Any] | None, traction_per_m: NDArray[Any], robot: Robot) -> NDArray[Any] | None:
        """Standard deviation of 1 m segments after the calibration [J]."""
        if self.correction.spread is None:
            return std_j
        return assumed_std(std_j, traction_per_m, robot) * traction_per_m.dtype.type(self.correction.spread.factor)

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

        Where the effects leave less than nothing of the motion, the price follows as far as regeneration returns it.
        """
        rows = planned_features(heightmap, robot, x, y, heading_rad, traction, self.correction.conditions)
        if self.correction.charge:
            rows = replace(rows, unit_j=robot.nominal_voltage_v)
        rows = replace(rows, drives=replace(self.correction.drives, motor_speed_mps=None))
        energy = self._energy(rows, np.zeros(x.size), planned=True)
        motion = rows.unit_j * (energy - rows.hotel_part)
        down = motion / robot.regeneration if robot.regeneration > 0 else np.minimum(np.asarray(traction, float), 0.0)
        return np.where(motion >= 0, motion, down)
