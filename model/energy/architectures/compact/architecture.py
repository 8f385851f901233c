"""The compact network as the project asks it: how it is built, fed, trained and used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.dense import CompactPredictor
from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, REACH_M, SQUARE, track_features
from joulemap.model.energy.architectures.compact.weights import (
    CompactConfig,
    CompactWeights,
    heading_basis,
    with_all_features,
)
from joulemap.model.energy.architectures.contract import Architecture, TrainingDefaults
from joulemap.model.energy.examples import Examples, FloatArray
from joulemap.model.energy.learned import Facts
from joulemap.model.energy.uncertainty import LEAST_SHARE
from joulemap.model.errors import ModelError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_squares

if TYPE_CHECKING:  # torch takes seconds to load: only training needs it
    from torch import Tensor

    from joulemap.model.energy.architectures.compact.net import CompactNet
    from joulemap.model.energy.tensors import ExampleTensors, NetworkOutput


class Compact(Architecture["CompactNet"]):
    """The fast, dense network that joulemap ships.

    A day of driving is about a thousand segments, so that batches are small. Every segment is learned from eight
    directions: runs often go to and fro in one direction, and a network that has seen no other errs in all others. One
    thread trains: the layers are too small to share between cores, so that one thread is nearly as fast on an idle
    machine and many times faster on a busy one, and its sums are always added in the same order.
    """

    name = "compact"
    size = SQUARE
    at_once = 2048
    training = TrainingDefaults(
        learning_rate=1e-3, fine_tuning_rate=5e-4, batch=64, epochs=12, copies=8, cross_fitted=True, threads=1
    )
    shape_free = True

    def build(self, config: Mapping[str, Any], *, size: int) -> CompactNet:
        """Make a network, as `Architecture.build`. Its working pixels are those of this version."""
        from joulemap.model.energy.architectures.compact.net import CompactNet

        return CompactNet(_widths(config, size))

    def config_of(self, net: CompactNet) -> dict[str, Any]:
        """Describe a network, as `Architecture.config_of`: the side of a working pixel and the widths."""
        return {"pixel_m": PIXEL_M, **net.config.as_dict()}

    def input_size(self, wanted: int | None) -> int:
        """Return the one size that this network reads."""
        return SQUARE

    def cut_inputs(
        self,
        heightmap: Heightmap,
        x: FloatArray,
        y: FloatArray,
        heading_rad: FloatArray,
        *,
        size: int,
        turned_rad: FloatArray,
    ) -> NDArray[np.float32]:
        """Cut north-up squares of 2 m, as `Architecture.cut_inputs`."""
        return cut_squares(heightmap, x, y, size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M, turned_rad=turned_rad)

    def answer(
        self,
        net: CompactNet,
        data: ExampleTensors,
        part: Tensor,
        *,
        leak: float,
        quarter_turns: int = 0,
        mirror: bool = False,
        jitter: float = 0.0,
    ) -> NetworkOutput:
        """Ask a network, as `Architecture.answer`. Errors count relative to at least a share of level ground."""
        import torch

        from joulemap.model.energy.tensors import NetworkOutput

        inputs = data.inputs[part]
        if mirror:
            inputs = inputs.flip(2)
        heading = -data.heading[part] if mirror else data.heading[part]
        if quarter_turns:
            inputs = torch.rot90(inputs, -quarter_turns, (1, 2))
            heading = heading + quarter_turns * (math.pi / 2)
        features = data.features[part]
        if jitter:
            noise = jitter * (net.feature_high - net.feature_low) * torch.randn_like(features)
            noise[:, -2:] = 0.0  # resolution and noise of the map are no traits of a robot
            features = features + noise
        basis = torch.from_numpy(heading_basis(heading.numpy(), net.config.order))
        tracks = data.derived("tracks", _tracks)[part]
        over_weight, spread = net(inputs, features, basis, tracks, data.grade[part], data.rolling[part])
        energy = data.energy_of(data.weight[part] * over_weight, part, leak=leak)
        least = LEAST_SHARE * (data.hotel[part] + data.weight[part] * data.rolling[part])
        return NetworkOutput(energy, torch.maximum(data.measured[part].abs(), least), spread)

    def initial(self, examples: Examples, start_from: CompactNet | None) -> CompactNet:
        """Return the network that a training starts with, as `Architecture.initial`.

        A fresh network knows the ranges of these examples. A copy keeps its own: moving them would change what every
        robot's features mean.
        """
        import torch

        net = super().initial(examples, start_from)
        if start_from is None:
            net.set_feature_ranges(examples.features.min(axis=0), examples.features.max(axis=0))
        return net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def read(self, config: Mapping[str, Any], weights: Mapping[str, NDArray[Any]], *, size: int) -> CompactNet:
        """Make a network with given weights, those of an older version too."""
        return super().read(config, with_all_features(weights), size=size)

    def adapted(self, net: CompactNet, *, level: float, climb: float, shape: float) -> CompactNet:
        """Return a network with another traction, as `Architecture.adapted`."""
        return net.adapted(level=level, climb=climb, shape=shape)

    def scaled(self, net: CompactNet, factor: float) -> CompactNet:
        """Return a network with more traction, as `Architecture.scaled`."""
        return net.scaled(factor)

    def predictor(self, net: CompactNet, facts: Facts) -> CompactPredictor:
        """Make a predictor that answers for whole maps in dense passes."""
        return CompactPredictor(net.weights(), facts)

    def predictor_of_weights(
        self, config: Mapping[str, Any], weights: Mapping[str, NDArray[Any]], facts: Facts
    ) -> CompactPredictor:
        """Make a predictor of the weights alone, as `Architecture.predictor_of_weights`: torch is not loaded."""
        return CompactPredictor(CompactWeights(with_all_features(weights), _widths(config, facts.size)), facts)


def _widths(config: Mapping[str, Any], size: int) -> CompactConfig:
    """Of a network that this version can ask."""
    widths = dict(config)
    pixel = widths.pop("pixel_m", None if widths else PIXEL_M)
    if pixel != PIXEL_M or size != SQUARE:
        raise ModelError(f"the network reads {size} pixels of {pixel} m, this version {SQUARE} of {PIXEL_M}")
    return CompactConfig.from_dict(widths)


def _tracks(examples: Examples) -> NDArray[np.float32]:
    """(n, 9); turning and mirroring the ground together with the heading does not change them."""
    headings, widths = examples.heading_rad.astype(np.float64), examples.features[:, 1].astype(np.float64)
    return track_features(examples.inputs, headings, widths)
