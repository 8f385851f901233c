"""What a network learns from: pieces of heightmap, the robot that crossed them, and the energy that this took."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.architectures import DEFAULT_ARCHITECTURE, find_architecture
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.robot_features import FEATURES, robot_features
from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

MAX_TURN_RAD = 0.25
"""Segments that turn by more are no examples of straight driving: turning has a price of its own."""

_USUAL = {"driven_m": 1.0, "beside_j": 0.0}  # of segments that go 1 m straight ahead


@dataclass(frozen=True, eq=False)
class Examples:
    """Measured 1 m segments as arrays of length n."""

    inputs: NDArray[np.float32]  # (n, S, S): Heights [m] that the network sees, cut as its architecture wants them
    features: NDArray[np.float32]  # (n, 8): `FEATURES` of the robot and the map
    heading_rad: NDArray[np.float32]  # (n,): Heading [rad]
    tan_grade: NDArray[np.float32]  # (n,): Tangent of the pitch along the motion, positive uphill
    weight_n: NDArray[np.float32]  # (n,): Weight of the robot and its load [N]
    rolling_resistance: NDArray[np.float32]  # (n,): Declared mu
    hotel_per_m: NDArray[np.float32]  # (n,): Energy per metre that does not move the robot [J/m]
    regeneration: NDArray[np.float32]  # (n,): Share of braking energy that returns to the battery
    voltage_v: NDArray[np.float32]  # (n,): Nominal voltage [V]
    energy_j: NDArray[np.float32]  # (n,): Energy drawn from the battery [J]
    run: NDArray[np.int64]  # (n,): The run a segment belongs to: whole runs are held out
    # (n,): Length of the track [m], by which a network's answer for 1 m is multiplied
    driven_m: NDArray[np.float32] = field(default_factory=lambda: np.ones(0, dtype=np.float32))
    # (n,): Energy that is known beside the network [J]: of turning, time and speeding up
    beside_j: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, dtype=np.float32))

    def __post_init__(self) -> None:
        n = len(self.inputs)
        for name, usual in _USUAL.items():
            if n and not len(getattr(self, name)):
                object.__setattr__(self, name, np.full(n, usual, dtype=np.float32))
        for item in fields(self):
            dtype = np.int64 if item.name == "run" else np.float32
            values = np.ascontiguousarray(getattr(self, item.name), dtype=dtype)
            if len(values) != n:
                raise InputError(f"{n} segments need as many {item.name}, got {len(values)}")
            if item.name != "run" and not np.isfinite(values).all():
                raise InputError(f"{item.name} of some segments is not finite: leave those segments out")
            object.__setattr__(self, item.name, values)

    def __len__(self) -> int:
        return len(self.inputs)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Examples:
        """Return some of the segments."""
        return Examples(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def data_hash(self) -> str:
        """SHA-256 of all arrays but usual `driven_m` and `beside_j`, 16 hex digits: the data a model was made from."""
        digest = hashlib.sha256()
        for item in fields(self):
            values = np.ascontiguousarray(getattr(self, item.name))
            if item.name not in _USUAL or (values != _USUAL[item.name]).any():
                digest.update(values.tobytes())
        return digest.hexdigest()[:16]

    def domain(self, *, max_slope_deg: float | None = None) -> Domain:
        """Return the ranges that these examples cover."""
        low, high = self.features.min(axis=0).astype(float), self.features.max(axis=0).astype(float)
        robot: dict[str, tuple[float, float]] = {}
        for k, key in enumerate(FEATURES[:-2]):
            pair = float(low[k]), float(high[k])
            if key.startswith("log_"):
                pair = math.exp(pair[0]), math.exp(pair[1])
            robot[key.removeprefix("log_")] = pair
        if max_slope_deg is None:
            max_slope_deg = math.degrees(math.atan(float(np.abs(self.tan_grade).max())))
        return Domain(robot, (2.0 ** float(low[-2]), 2.0 ** float(high[-2])), max_slope_deg)


def cut_examples(
    heightmap: Heightmap,
    robot: Robot,
    x: ArrayLike,
    y: ArrayLike,
    heading_rad: ArrayLike,
    energy_j: ArrayLike,
    *,
    run: ArrayLike = 0,
    payload_kg: ArrayLike = 0.0,
    architecture: str = DEFAULT_ARCHITECTURE,
    size: int | None = None,
    turned_rad: ArrayLike = 0.0,
    driven_m: ArrayLike = 1.0,
    beside_j: ArrayLike = 0.0,
) -> Examples:
    """Make examples of measured 1 m segments.

    Segments whose ground the heightmap does not know are left out: compare `len`.

    `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,); `energy_j` (n,); `run` (n,); `payload_kg` (n,): load
    on top of the robot's mass [kg]; `turned_rad` (n,): angle [rad] by which the world, ground and motion, is turned
    clockwise: the same energy, seen from another direction; `driven_m` (n,): length of the track [m]; `beside_j` (n,):
    energy that is known beside the network [J].
    """
    kind = find_architecture(architecture)
    arrays = np.broadcast_arrays(x, y, heading_rad, energy_j, run, payload_kg, turned_rad, driven_m, beside_j)
    xs, ys, heading, energy = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in arrays[:4])
    runs = np.ascontiguousarray(arrays[4], dtype=np.int64).ravel()
    turned = np.asarray(arrays[6], dtype=np.float64).ravel()
    grade = tan_grade(heightmap, xs, ys, heading)
    inputs = kind.cut_inputs(heightmap, xs, ys, heading, size=kind.input_size(size), turned_rad=turned)
    driven, beside = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in arrays[7:])
    known = np.isfinite(inputs[:, 0, 0]) & np.isfinite(grade) & np.isfinite(energy) & np.isfinite(beside)
    n = int(known.sum())

    def _same(value: float) -> NDArray[np.float32]:
        return np.full(n, value, dtype=np.float32)

    def _kept(values: FloatArray) -> NDArray[np.float32]:
        return values[known].astype(np.float32)

    weight_n = robot.gravity_mps2 * (robot.mass_kg + np.asarray(arrays[5], dtype=np.float64).ravel())
    return Examples(
        inputs[known],
        np.tile(robot_features(robot, heightmap.resolution_m, heightmap.removed_noise_m), (n, 1)),
        _kept(heading + turned),
        _kept(grade),
        _kept(weight_n),
        _same(robot.rolling_resistance),
        _same(robot.hotel_per_m),
        _same(robot.regeneration),
        _same(robot.nominal_voltage_v),
        _kept(energy),
        runs[known],
        _kept(driven),
        _kept(beside),
    )


def examples_of(
    heightmap: Heightmap, robot: Robot, segments: Segments, turned_rad: FloatArray, **given: Any
) -> list[Examples]:
    """Make examples of measured segments, once for each row of `turned_rad`, (copies, n); `given` as `cut_examples`."""
    s = segments
    given |= {"payload_kg": np.nan_to_num(s.extras.get("payload", np.zeros(len(s)))), "driven_m": s.driven_m}
    places = s.x, s.y, s.heading_rad, s.energy_j
    return [cut_examples(heightmap, robot, *places, turned_rad=turned, **given) for turned in turned_rad]


def concatenate(parts: Sequence[Examples]) -> Examples:
    """Join several sets of examples."""
    if not parts:
        raise InputError("there is no segment to learn from")
    return Examples(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Examples)))
