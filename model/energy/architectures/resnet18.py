"""The paper's network: ResNet18 without its classifier, and a head of 512, 256, 1 units; one patch, one energy.

The names of the backbone's weights are those of torchvision (conv1, bn1, layer1.0.conv1, ... layer4.1.bn2), so that its
ImageNet file loads. Sources: He et al. 2016, "Deep Residual Learning", table 1 (18 layers); Wei & Isler 2022, section
IV-B.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from joulemap.model.energy.architectures.contract import Architecture, TrainingDefaults
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.examples import Examples, FloatArray
from joulemap.model.energy.grade import SEGMENT_M
from joulemap.model.energy.tensors import ExampleTensors, NetworkOutput
from joulemap.model.errors import ModelError
from joulemap.model.frames import heading_vector
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches

_HEIGHT_SCALE_M = 0.1  # brings the heights of a patch to about one, as an image's pixels are


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        """Apply the block. `x` (B, inputs, H, W): features. The result is (B, outputs, H / stride, W / stride)."""
        shortcut = x if self.downsample is None else self.downsample(x)
        out = torch.relu(self.bn1(self.conv1(x)))
        return torch.relu(self.bn2(self.conv2(out)) + shortcut)


class ResNet18Backbone(nn.Module):
    """ResNet18 up to its average pool: (B, 3, H, W) -> (B, 512). 11,176,512 parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1 = nn.Sequential(BasicBlock(64, 64, 1), BasicBlock(64, 64, 1))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128, 1))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2), BasicBlock(256, 256, 1))
        self.layer4 = nn.Sequential(BasicBlock(256, 512, 2), BasicBlock(512, 512, 1))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        """Describe images by 512 numbers each.

        `x` is (B, 3, H, W). Result (B, 512): means over the last layer's pixels.
        """
        x = self.maxpool(torch.relu(self.bn1(self.conv1(x))))  # (B, 64, H / 4, W / 4)
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))  # (B, 512, H / 32, W / 32)
        return x.mean(dim=(2, 3))


class ResNetEnergy(Network):
    """The network from a patch of heights to the scaled energy e = E / V of its segment [A s].

    The one channel is repeated to three. `target_mean` and `target_scale` bring the head's output to the data's size; a
    scale of 0 marks a network that was never trained.
    """

    architecture = "resnet18"
    target_mean: Tensor
    target_scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.backbone = ResNet18Backbone()
        self.head = nn.Sequential(nn.Linear(512, 512), nn.ReLU(), nn.Linear(512, 256), nn.ReLU(), nn.Linear(256, 1))
        self.register_buffer("target_mean", torch.zeros(()))
        self.register_buffer("target_scale", torch.zeros(()))

    def forward(self, patches: Tensor) -> Tensor:
        """Answer for patches.

        `patches` (B, S, S): heights [m], minimum subtracted. Result (B,): scaled energy [A s].
        """
        image = (patches / _HEIGHT_SCALE_M)[:, None].expand(-1, 3, -1, -1)  # (B, 3, S, S)
        return self.target_mean + self.target_scale * self.head(self.backbone(image))[:, 0]


def fastest_device() -> torch.device:
    """Return a GPU where torch has one, else the processor.

    A GPU adds in another order than a processor: trained weights then differ in their last bits.
    """
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def load_backbone(path: str | Path) -> ResNet18Backbone:
    """Read a backbone from a file with torchvision's names, ImageNet's for instance."""
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"there is no weights file {path}", path=str(path))
    try:
        state: Mapping[str, Any] = (
            load_file(path)
            if path.suffix == ".safetensors"
            else torch.load(path, map_location="cpu", weights_only=True)
        )
        kept = {key: value for key, value in state.items() if not key.startswith("fc.")}
        backbone = ResNet18Backbone()
        backbone.load_state_dict(kept, strict=True)
    except (
        RuntimeError,
        SafetensorError,
        UnpicklingError,
        OSError,
        AttributeError,
        TypeError,
        EOFError,
        ValueError,
    ) as error:
        raise ModelError(
            f"{path} does not hold a ResNet18 with torchvision's names: {error}", path=str(path)
        ) from error
    return backbone


class ResNet18(Architecture[ResNetEnergy]):
    """The network of the paper: slow, and the reference that others are compared with.

    The learning rate is the paper's (section V-A). A pass keeps 4 MB for every patch of 256 x 256.
    """

    name = "resnet18"
    size = 64  # 256 in the paper
    at_once = 256
    training = TrainingDefaults(learning_rate=1e-4, batch=32, epochs=60, least_batch=2)

    def build(self, config: Mapping[str, Any], *, size: int) -> ResNetEnergy:
        """Make a network, as `Architecture.build`. It reads patches of any size and has no settings."""
        return ResNetEnergy()

    def config_of(self, net: ResNetEnergy) -> dict[str, Any]:
        """Describe a network, as `Architecture.config_of`: there is nothing to say."""
        return {}

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
        """Cut the paper's patches along the heading, as `Architecture.cut_inputs`; each starts with its segment."""
        dx, dy = heading_vector(heading_rad)
        half = 0.5 * SEGMENT_M
        return cut_patches(heightmap, x - half * dx, y - half * dy, heading_rad, size=size, side_m=SEGMENT_M)

    def answer(
        self,
        net: ResNetEnergy,
        data: ExampleTensors,
        part: Tensor,
        *,
        leak: float,
        quarter_turns: int = 0,
        mirror: bool = False,
        jitter: float = 0.0,
    ) -> NetworkOutput:
        """Ask a network, as `Architecture.answer`. It gives the energy directly and knows no traction or spread."""
        inputs = data.inputs[part]
        if mirror:
            inputs = inputs.flip(2)
        return NetworkOutput(net(inputs) * data.voltage[part], data.measured[part].abs().clamp_min(1e-6), None)

    def initial(self, examples: Examples, start_from: ResNetEnergy | None) -> ResNetEnergy:
        """Return the network that a training starts with, as `Architecture.initial`.

        A head that was never trained starts at the mean and the standard deviation of the data.
        """
        net = super().initial(examples, start_from)
        if not net.target_scale.any():
            scaled = examples.energy_j / examples.voltage_v
            net.target_mean = torch.as_tensor(float(scaled.mean()))
            net.target_scale = torch.tensor(max(float(scaled.std()), 1e-6))
        return net

    def scaled(self, net: ResNetEnergy, factor: float) -> ResNetEnergy:
        """Return a network with more energy, as `Architecture.scaled`."""
        other = deepcopy(net)
        other.target_mean, other.target_scale = factor * net.target_mean, factor * net.target_scale
        return other

    def device(self) -> torch.device:
        """Return the graphics processor where torch has one."""
        return fastest_device()

    def backbone_of(self, net: ResNetEnergy) -> nn.Module:
        """Return everything but the head."""
        return net.backbone

    def from_backbone(self, path: Path) -> ResNetEnergy:
        """Make a network around a backbone's weights, as `Architecture.from_backbone`."""
        net = ResNetEnergy()
        net.backbone = load_backbone(path)
        return net
