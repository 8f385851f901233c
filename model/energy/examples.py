"""What a network learns from: pieces of heightmap, the robot that crossed them, and the energy it took."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.compact import FEATURES, robot_features
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.physics import SEGMENT_M, tan_grade
from joulemap.model.energy.tracks import PIXEL_M, REACH_M, SQUARE
from joulemap.model.errors import InputError, ModelError
from joulemap.model.frames import heading_vector
from joulemap.model.robot import GRAVITY_MPS2, Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches, cut_squares

FloatArray = NDArray[np.float64]

ARCHITECTURES = ("compact", "resnet18")
RESNET_SIZE = 64
"""Rows and columns of a ResNet18 patch unless told otherwise; the paper's are 256."""


@dataclass(frozen=True, eq=False)
class Examples:
    """Measured 1 m segments as arrays of n.

    inputs : (n, S, S) float32 [m], north-up squares (compact) or patches along the heading (resnet18). features :
    (n, 8) float32, `compact.FEATURES`. heading_rad, tan_grade, weight_n, rolling_resistance, hotel_per_m [J/m],
    regeneration, voltage_v : (n,) float32. energy_j : (n,) float32, drawn from the battery. run : (n,) int64, which run
    a segment belongs to: whole runs are held out.
    """

    inputs: NDArray[np.float32]
    features: NDArray[np.float32]
    heading_rad: NDArray[np.float32]
    tan_grade: NDArray[np.float32]
    weight_n: NDArray[np.float32]
    rolling_resistance: NDArray[np.float32]
    hotel_per_m: NDArray[np.float32]
    regeneration: NDArray[np.float32]
    voltage_v: NDArray[np.float32]
    energy_j: NDArray[np.float32]
    run: NDArray[np.int64]

    def __post_init__(self) -> None:
        n = len(self.inputs)
        for field in fields(self):
            dtype = np.int64 if field.name == "run" else np.float32
            values = np.ascontiguousarray(getattr(self, field.name), dtype=dtype)
            if len(values) != n:
                raise InputError(f"{n} segments need as many {field.name}, got {len(values)}")
            if field.name != "run" and not np.isfinite(values).all():
                raise InputError(f"{field.name} of some segments is not finite: leave those segments out")
            object.__setattr__(self, field.name, values)

    def __len__(self) -> int:
        return len(self.inputs)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Examples:
        """The segments of a mask or of indices."""
        return Examples(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def data_hash(self) -> str:
        """SHA-256 (16 hex digits) of every array: which data a model was made from."""
        digest = hashlib.sha256()
        for field in fields(self):
            digest.update(np.ascontiguousarray(getattr(self, field.name)).tobytes())
        return digest.hexdigest()[:16]

    def domain(self, *, max_slope_deg: float | None = None) -> Domain:
        """The ranges these examples cover. max_slope_deg : where it is known better than from the segments' grades."""
        low, high = self.features.min(axis=0).astype(float), self.features.max(axis=0).astype(float)
        robot: dict[str, tuple[float, float]] = {}
        for k, key in enumerate(FEATURES[:-1]):
            pair = float(low[k]), float(high[k])
            if key.startswith("log_"):
                pair = math.exp(pair[0]), math.exp(pair[1])
            robot[key.removeprefix("log_")] = pair
        if max_slope_deg is None:
            max_slope_deg = math.degrees(math.atan(float(np.abs(self.tan_grade).max())))
        return Domain(robot, (2.0 ** float(low[-1]), 2.0 ** float(high[-1])), max_slope_deg)


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
    architecture: str = "compact",
    size: int = RESNET_SIZE,
    turned_rad: ArrayLike = 0.0,
) -> Examples:
    """Examples from 1 m segments centred at (x, y) [m], (n,) each. run, payload_kg : (n,) or one number.

    Segments whose ground the heightmap does not know are left out (compare `len`). size : of a ResNet18 patch.
    turned_rad : squares are cut as if the world, ground and motion, were turned clockwise by so much, (n,) (compact
    only): the same energy, seen from another side. Raises ModelError for an unknown architecture.
    """
    arrays = np.broadcast_arrays(x, y, heading_rad, energy_j, run, payload_kg, turned_rad)
    xs, ys, heading, energy = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in arrays[:4])
    runs = np.ascontiguousarray(arrays[4], dtype=np.int64).ravel()
    turned = np.asarray(arrays[6], dtype=np.float64).ravel()
    grade = tan_grade(heightmap, xs, ys, heading)
    if architecture == "compact":
        inputs = cut_squares(heightmap, xs, ys, size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M, turned_rad=turned)
    elif architecture == "resnet18":
        inputs = cut_patches_around(heightmap, xs, ys, heading, size=size)
    else:
        raise ModelError(f"no architecture {architecture!r}: known are {', '.join(ARCHITECTURES)}", name=architecture)
    known = np.isfinite(inputs[:, 0, 0]) & np.isfinite(grade) & np.isfinite(energy)
    n = int(known.sum())

    def same(value: float) -> NDArray[np.float32]:
        return np.full(n, value, dtype=np.float32)

    def kept(values: FloatArray) -> NDArray[np.float32]:
        return values[known].astype(np.float32)

    weight_n = GRAVITY_MPS2 * (robot.mass_kg + np.asarray(arrays[5], dtype=np.float64).ravel())
    return Examples(
        inputs[known],
        np.tile(robot_features(robot, heightmap.resolution_m), (n, 1)),
        kept(heading + turned),
        kept(grade),
        kept(weight_n),
        same(robot.rolling_resistance),
        same(robot.hotel_per_m),
        same(robot.regeneration),
        same(robot.nominal_voltage_v),
        kept(energy),
        runs[known],
    )


def cut_patches_around(
    heightmap: Heightmap, x: FloatArray, y: FloatArray, heading_rad: FloatArray, *, size: int
) -> NDArray[np.float32]:
    """The paper's patches of segments *centred* at (x, y): each starts half a metre before. (n, size, size)."""
    dx, dy = heading_vector(heading_rad)
    half = 0.5 * SEGMENT_M
    return cut_patches(heightmap, x - half * dx, y - half * dy, heading_rad, size=size, side_m=SEGMENT_M)


def concatenate(parts: Sequence[Examples]) -> Examples:
    """All examples of several sets, in order. Raises InputError for none."""
    if not parts:
        raise InputError("there is no segment to learn from")
    return Examples(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Examples)))
