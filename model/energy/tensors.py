"""Examples as tensors, and what a network says of them: the forward pass that training and judging share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from joulemap.model.energy.architectures import find_architecture
from joulemap.model.energy.examples import Examples
from joulemap.model.energy.uncertainty import USUAL_SPREAD, segment_std

if TYPE_CHECKING:
    from joulemap.model.energy.architectures.network import Network

CPU = torch.device("cpu")


@dataclass(frozen=True)
class NetworkOutput:
    """What a network answers for B segments."""

    energy: Tensor  # Energy [J]
    # What the errors of a training are relative to [J]: the measured energy, or a floor where it is small
    scale: Tensor
    spread: Tensor | None  # Logarithm of the standard deviation over the energy; None where the network knows none


class ExampleTensors:
    """Examples as tensors on a device, and the energy that a network on that device gives them.

    `inputs` (n, S, S): heights [m]; `features` (n, 8): `FEATURES` of the robot; `heading`, `grade`, `weight`,
    `rolling`, `hotel`, `regeneration`, `voltage`, `measured`, `driven`, `beside` (n,): the columns of `Examples`, in
    their units.
    """

    def __init__(self, examples: Examples, device: torch.device = CPU) -> None:
        self.examples, self.device = examples, device

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
        self.driven = placed(examples.driven_m)
        self.beside = placed(examples.beside_j)
        self._derived: dict[str, Tensor] = {}

    def derived(self, key: str, make: Callable[[Examples], NDArray[np.float32]]) -> Tensor:
        """Return what an architecture computes from the examples once and needs in every pass."""
        if key not in self._derived:
            self._derived[key] = torch.from_numpy(make(self.examples)).to(self.device)
        return self._derived[key]

    def energy_of(self, traction: Tensor, part: Tensor, *, leak: float) -> Tensor:
        """Return the energy that segments take from the battery.

        `traction` (B,): traction demand [J]; `part` (B,): which examples. Result (B,): energy [J].
        """
        down = torch.clamp_max(traction, 0.0) * torch.clamp_min(self.regeneration[part], leak)
        return self.hotel[part] + torch.relu(traction) + down

    def answer(
        self,
        net: Network,
        part: Tensor,
        *,
        leak: float,
        quarter_turns: int = 0,
        mirror: bool = False,
        jitter: float = 0.0,
    ) -> NetworkOutput:
        """Ask a network for the energy of some examples.

        `part` (B,); `quarter_turns`, `mirror`, `jitter`: augmentations, as `Architecture.answer`: the ground is turned
        clockwise after being mirrored east to west, and headings go with it. Result: of the B examples: what the
        network says of a metre times the metres driven, and what is known beside it.
        """
        architecture = find_architecture(net.architecture)
        straight = architecture.answer(
            net, self, part, leak=leak, quarter_turns=quarter_turns, mirror=mirror, jitter=jitter
        )
        return replace(straight, energy=straight.energy * self.driven[part] + self.beside[part])


def predicted(net: Network, examples: Examples) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ask a network for the energy of all examples, on the processor.

    Returns `energy` (n,): energy [J]; `std` (n,): standard deviation [J] as the network estimates it, before any
    calibration on held-out runs.
    """
    net.eval()
    batch = find_architecture(net.architecture).at_once
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
