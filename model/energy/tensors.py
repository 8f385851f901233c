"""Examples as tensors, and what a network says of them: the forward pass that training and judging share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from joulemap.model.energy.compact import CompactNet, heading_basis
from joulemap.model.energy.examples import Examples
from joulemap.model.energy.resnet import ResNetEnergy
from joulemap.model.energy.tracks import SQUARE, track_features
from joulemap.model.energy.uncertainty import LEAST_SHARE, USUAL_SPREAD, segment_std

Network = CompactNet | ResNetEnergy

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Answer:
    """What a network says of B segments. energy [J]. scale [J] : what errors are relative to. spread : logarithm of the
    standard deviation over the energy, None where the network has none.
    """

    energy: Tensor
    scale: Tensor
    spread: Tensor | None


class ExampleTensors:
    """Examples as tensors on a device, and the energy a network on that device gives them."""

    def __init__(self, examples: Examples, device: torch.device = CPU) -> None:
        def placed(values: NDArray[np.float32]) -> Tensor:
            return torch.from_numpy(values).to(device)

        self.inputs = placed(examples.inputs)
        self.features = placed(examples.features)
        self.heading = placed(examples.heading_rad)
        self.grade = placed(examples.tan_grade)
        self.weight = placed(examples.weight_n)
        self.rolling = placed(examples.rolling_resistance)
        self.hotel = placed(examples.hotel_per_m)
        self.regeneration = placed(examples.regeneration)
        self.voltage = placed(examples.voltage_v)
        self.measured = placed(examples.energy_j)
        self.tracks = torch.empty(0)
        if examples.inputs.shape[1] == SQUARE:  # turning and mirroring the ground leaves them as they are
            self.tracks = torch.from_numpy(
                track_features(
                    examples.inputs, examples.heading_rad.astype(np.float64), examples.features[:, 1].astype(np.float64)
                )
            )

    def answer(
        self,
        net: Network,
        part: Tensor,
        *,
        leak: float,
        quarter_turns: int = 0,
        mirror: bool = False,
        jitter: float = 0.0,
    ) -> Answer:
        """What the network says of the segments `part`.

        The ground is turned clockwise by quarter turns after being mirrored east to west; headings go with it.
        """
        inputs = self.inputs[part]
        measured = self.measured[part]
        if mirror:
            inputs = inputs.flip(2)
        if isinstance(net, ResNetEnergy):
            return Answer(net(inputs) * self.voltage[part], measured.abs().clamp_min(1e-6), None)
        heading = -self.heading[part] if mirror else self.heading[part]
        if quarter_turns:
            inputs = torch.rot90(inputs, -quarter_turns, (1, 2))
            heading = heading + quarter_turns * (math.pi / 2)
        features = self.features[part]
        if jitter:
            noise = jitter * (net.feature_high - net.feature_low) * torch.randn_like(features)
            noise[:, -1] = 0.0  # the map's resolution is no trait of a robot
            features = features + noise
        basis = torch.from_numpy(heading_basis(heading.numpy(), net.config.order))
        over_weight, spread = net(inputs, features, basis, self.tracks[part], self.grade[part], self.rolling[part])
        traction = self.weight[part] * over_weight
        hotel = self.hotel[part]
        down = torch.clamp_max(traction, 0.0) * torch.clamp_min(self.regeneration[part], leak)
        least = LEAST_SHARE * (hotel + self.weight[part] * self.rolling[part])
        return Answer(hotel + torch.relu(traction) + down, torch.maximum(measured.abs(), least), spread)


def at_once(net: Network) -> int:
    """Segments that one pass may judge: a ResNet18 keeps 4 MB for every patch of 256 x 256."""
    return 2048 if isinstance(net, CompactNet) else 256


def predicted(net: Network, examples: Examples) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(energy, its standard deviation as the network believes it) [J] of every example, (n,) each."""
    net.eval()
    batch = at_once(net)
    data = ExampleTensors(examples)
    energy, relative = np.empty(len(examples)), np.full(len(examples), USUAL_SPREAD)
    with torch.inference_mode():
        for k in range(0, len(examples), batch):
            part = torch.arange(k, min(k + batch, len(examples)))
            answer = data.answer(net, part, leak=0.0)
            energy[part.numpy()] = answer.energy.numpy()
            if answer.spread is not None:
                relative[part.numpy()] = torch.exp(answer.spread).numpy()
    level = examples.hotel_per_m + examples.weight_n * examples.rolling_resistance
    return energy, segment_std(energy, relative, level, factor=1.0)
