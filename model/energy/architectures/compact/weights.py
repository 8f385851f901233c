"""The weights of a compact network as arrays, and what they are for one robot: nothing here needs torch.

The layers are described in `net`, which trains them. A robot's scales and shifts are folded into the weights, so that
a map is priced without them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.architectures.compact.tracks import TRACKS
from joulemap.model.energy.robot_features import FEATURES
from joulemap.model.errors import ModelError
from joulemap.model.terrain.denoising import LEAST_NOISE_M

STRIDE = 8
"""Working pixels between neighbouring answers."""
KERNELS = 4, 3, 3
"""Sides of the three convolutions, which have a stride of 2."""
HEAD_BLOCK = 8
"""Inputs of the head's layers that the compiled loop adds up at a time."""
SLOPE_SCALE = 4.0
"""Brings slopes of rough ground to about one."""
REST_SCALE = 0.1
"""What is left to learn, over the weight, is a tenth of it."""
SPREAD_RANGE = (math.log(0.01), math.log(2.0))
"""Logarithms of the relative standard deviations that the head can answer."""

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class CompactConfig:
    """Widths of the network's layers."""

    channels: tuple[int, int, int] = (16, 32, 64)  # Of the three strided convolutions
    hidden: int = 64  # Of the layer after them
    order: int = 2  # Highest harmonic of the heading
    head: tuple[int, int] = (24, 16)  # Of the head's two layers
    robot_hidden: int = 32  # Of the layer that reads the robot

    def as_dict(self) -> dict[str, Any]:
        """Return the widths, JSON-able."""
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> CompactConfig:
        """Make a configuration of what `as_dict` wrote."""
        converted: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        try:
            return cls(**converted)
        except TypeError as error:
            raise ModelError(f"the network's description does not fit this version: {error}") from error


def heading_basis(heading_rad: ArrayLike, order: int) -> FloatArray:
    """Return 1, sin h, cos h, sin 2h, ... of every heading. `heading_rad` is (n,). The result is (n, 2 order + 1)."""
    heading = np.asarray(heading_rad, dtype=np.float64).ravel()
    columns = [np.ones_like(heading)]
    for harmonic in range(1, order + 1):
        columns += [np.sin(harmonic * heading), np.cos(harmonic * heading)]
    return np.stack(columns, axis=1).astype(np.float32)


@dataclass(frozen=True)
class RobotWeights:
    """The network for one robot."""

    # Weight (outputs, inputs) and bias (outputs,) of the three convolutions, the hidden layer and the series, one
    # after another. The inputs of a convolution are ordered by channel, row and column.
    ground: tuple[FloatArray, ...]
    # Tracks (units, 9) and shift (units,), head (last, units) and bias, rest and spread (2, last) and their biases
    # (2,). Units and last are padded with zeros to multiples of `HEAD_BLOCK`.
    head: tuple[FloatArray, ...]
    units: int  # Of the head's first layer, without padding
    gains: tuple[float, float]  # Gains a and c of the rolling resistance and of the grade

    def ask(self, series: FloatArray, basis: FloatArray, tracks: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate the head at one heading of each place.

        `series` (units * C, n): as from `ground.read_ground`; `basis` (n, C): as from `heading_basis`; `tracks` (n, 9):
        as from `track_features`. Returns `rest` (n,): traction over weight beyond eq. 5; `spread` (n,): logarithm of
        the standard deviation over the energy.
        """
        of_tracks, shift, head, bias, last, last_bias = self.head
        units = np.einsum("ucn,nc->nu", series.reshape(self.units, basis.shape[1], -1), basis)
        first = np.maximum(units + tracks @ of_tracks[: self.units].T + shift[: self.units], 0.0)
        second = np.maximum(first @ head[:, : self.units].T + bias, 0.0)
        out = second @ last.T + last_bias
        return out[:, 0], np.clip(out[:, 1], *SPREAD_RANGE)


@dataclass(frozen=True)
class CompactWeights:
    """The weights of a trained compact network."""

    arrays: Mapping[str, FloatArray]  # By the names that they have in the network, as in weights.safetensors
    config: CompactConfig  # Widths of the layers

    def __post_init__(self) -> None:
        wanted = _shapes(self.config)
        missing, foreign = sorted(wanted.keys() - self.arrays), sorted(self.arrays.keys() - wanted)
        if missing or foreign:
            names = f"missing: {', '.join(missing) or 'none'}, unknown: {', '.join(foreign) or 'none'}"
            raise ModelError(f"the weights do not fit the network: {names}")
        for name, shape in wanted.items():
            if self.arrays[name].shape != shape:
                words = f"{name} has the shape {self.arrays[name].shape}, its layer {shape}"
                raise ModelError(f"the weights do not fit the network: {words}")

    def for_robot(self, features: FloatArray) -> RobotWeights:
        """Return the network for one robot.

        A robot outside the learned ranges gets the answers of the nearest robot inside.

        `features` (9,): as from `robot_features`. Result: with the robot's scales and shifts folded in.
        """
        known, config = self.arrays, self.config
        low, high = known["feature_low"], known["feature_high"]
        unit = 2.0 * (np.clip(features, low, high) - low) / (high - low) - 1.0
        code = np.tanh(known["robot.weight"] @ unit + known["robot.bias"])
        film = known["film.weight"] @ code + known["film.bias"]
        third, hidden, units = config.channels[2], config.hidden, config.head[0]
        scale2, shift2, scale3, shift3, scale, shift = np.split(film, np.cumsum([third, third, hidden, hidden, units]))
        ground = (
            *(known["conv0.weight"] * SLOPE_SCALE, known["conv0.bias"]),
            *(known["conv1.weight"], known["conv1.bias"]),
            *_scaled(known["conv2.weight"], known["conv2.bias"], scale2, shift2),
            *_scaled(known["hidden.weight"], known["hidden.bias"], scale3, shift3),
            *(known["series.weight"], known["series.bias"]),
        )
        more, last_more = (-size % HEAD_BLOCK for size in config.head)
        head = (
            np.pad(known["tracks.weight"] * (1.0 + scale)[:, None], ((0, more), (0, 0))),
            np.pad(shift, (0, more)),
            np.pad(known["head.weight"], ((0, last_more), (0, more))),
            np.pad(known["head.bias"], (0, last_more)),
            np.pad(np.vstack([REST_SCALE * known["rest.weight"], known["spread.weight"]]), ((0, 0), (0, last_more))),
            np.concatenate([REST_SCALE * known["rest.bias"], known["spread.bias"]]),
        )
        gains = 1.0 + known["gains.weight"] @ code + known["gains.bias"]
        return RobotWeights(
            tuple(_flat(array.reshape(len(array), -1) if array.ndim > 1 else array) for array in ground),
            tuple(_flat(array) for array in head),
            units,
            (float(gains[0]), float(gains[1])),
        )


def with_all_features(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of a network, of which an older one knows eight `FEATURES`: the ninth changes nothing in it."""
    known = dict(arrays)
    if {"robot.weight", "feature_low", "feature_high"} <= known.keys() and len(known["feature_low"]) == 8:
        low, high = math.log2(LEAST_NOISE_M), 0.0  # of "log2_noise_m", the only one that was added
        known["robot.weight"] = np.pad(known["robot.weight"], ((0, 0), (0, 1)))
        known["feature_low"] = np.append(known["feature_low"], np.float32(low))
        known["feature_high"] = np.append(known["feature_high"], np.float32(high))
    return known


def _scaled(
    weight: FloatArray, bias: FloatArray, scale: FloatArray, shift: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A layer whose answers are scaled by 1 + scale and shifted."""
    return weight * (1.0 + scale)[:, None, None, None], bias * (1.0 + scale) + shift


def _flat(array: FloatArray) -> FloatArray:
    return np.ascontiguousarray(array, dtype=np.float32)


def _shapes(config: CompactConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of all arrays by their names."""
    first, second, third = config.channels
    units, last = config.head
    features, robot = len(FEATURES), config.robot_hidden
    layers = {
        "conv0": (first, 3, KERNELS[0], KERNELS[0]),
        "conv1": (second, first, KERNELS[1], KERNELS[1]),
        "conv2": (third, second, KERNELS[2], KERNELS[2]),
        "hidden": (config.hidden, third, 1, 1),
        "series": (units * (2 * config.order + 1), config.hidden, 1, 1),
        "head": (last, units),
        "rest": (1, last),
        "spread": (1, last),
        "robot": (robot, features),
        "film": (2 * (third + config.hidden + units), robot),
        "gains": (2, robot),
    }
    shapes: dict[str, tuple[int, ...]] = {f"{name}.weight": shape for name, shape in layers.items()}
    shapes |= {f"{name}.bias": shape[:1] for name, shape in layers.items()}
    return shapes | {"tracks.weight": (units, len(TRACKS)), "feature_low": (features,), "feature_high": (features,)}
