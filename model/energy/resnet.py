"""The paper's network: ResNet18 without its classifier, and a head of 512, 256, 1; one patch, one energy.

State-dict names of the backbone are torchvision's (conv1, bn1, layer1.0.conv1, ... layer4.1.bn2), so that its ImageNet
file loads. Sources: He et al. 2016, "Deep Residual Learning", table 1 (18 layers); Wei & Isler 2022, section IV-B.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from joulemap.model.energy.domain import Domain, Learned
from joulemap.model.energy.physics import SEGMENT_M
from joulemap.model.energy.uncertainty import USUAL_SPREAD, Spread, segment_std
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame, heading_vector
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches

FloatArray = NDArray[np.float64]

_HEIGHT_SCALE_M = 0.1  # brings the heights of a patch to about one, as an image's pixels are
_BATCH = 256


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut; `downsample` where shape changes."""

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
        x = self.maxpool(torch.relu(self.bn1(self.conv1(x))))  # (B, 64, H / 4, W / 4)
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))  # (B, 512, H / 32, W / 32)
        return x.mean(dim=(2, 3))


class ResNetEnergy(nn.Module):
    """Patches (B, S, S) [m], minimum subtracted -> scaled energy e = E / V of the segment (B,) [A s].

    The one channel is repeated to three. target_mean and target_scale bring the head's output to the data's size; a
    scale of 0 marks a network that was never trained.
    """

    target_mean: Tensor
    target_scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.backbone = ResNet18Backbone()
        self.head = nn.Sequential(nn.Linear(512, 512), nn.ReLU(), nn.Linear(512, 256), nn.ReLU(), nn.Linear(256, 1))
        self.register_buffer("target_mean", torch.zeros(()))
        self.register_buffer("target_scale", torch.zeros(()))

    def forward(self, patches: Tensor) -> Tensor:
        image = (patches / _HEIGHT_SCALE_M)[:, None].expand(-1, 3, -1, -1)  # (B, 3, S, S)
        return self.target_mean + self.target_scale * self.head(self.backbone(image))[:, 0]


def fastest_device() -> torch.device:
    """A GPU where torch has one. Its sums run in another order than a processor's: weights then differ in last bits."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def load_backbone(path: str | Path) -> ResNet18Backbone:
    """A backbone from a file with torchvision's names (.pth, .pt or .safetensors), ImageNet's for instance.

    Everything but `fc.*` must fit exactly, else ModelError.
    """
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


class ResNetPredictor(Learned):
    """The paper's network on any map: a patch per place and heading (slow: the yardstick, not the working horse).

    The network gives battery energy; its traction is that energy without the robot's hotel load, so that the price is
    the network's answer wherever it is not below the hotel load. NaN where a patch meets unknown ground.
    """

    def __init__(
        self,
        net: ResNetEnergy,
        domain: Domain,
        provenance: Mapping[str, Any],
        *,
        size: int,
        name: str,
        spread: Spread | None = None,
        turn_j_per_rad: float = 0.0,
    ) -> None:
        super().__init__(name, domain, provenance, spread=spread, turn_j_per_rad=turn_j_per_rad)
        self.device = fastest_device()
        self.net = net.to(self.device).eval()
        self.size = size

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(traction [J/m], standard deviation of a 1 m segment's energy [J]), (rows, cols, headings) float32 each, at
        the cell centres of `frame`; NaN where the map is unknown.
        """
        x, y = frame.centres()
        shape = frame.rows, frame.cols, len(headings_rad)
        places = np.broadcast_arrays(x[None, :, None], y[:, None, None], np.asarray(headings_rad)[None, None, :])
        traction, std = self.segment_traction_and_std(heightmap, robot, *places)
        return traction.reshape(shape).astype(np.float32), std.reshape(shape).astype(np.float32)

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """The same for 1 m segments centred at (x, y). (n,) float64 each. The network knows no spread of its own: the
        deviation is the share of the energy that held-out runs showed.
        """
        places = np.broadcast_arrays(x, y, heading_rad)
        xs, ys, heading = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in places)
        dx, dy = heading_vector(heading)
        start_x, start_y = xs - 0.5 * SEGMENT_M * dx, ys - 0.5 * SEGMENT_M * dy
        out = np.full(xs.size, np.nan)
        with torch.inference_mode():
            for k in range(0, xs.size, _BATCH):
                part = slice(k, k + _BATCH)
                patches = cut_patches(
                    heightmap, start_x[part], start_y[part], heading[part], size=self.size, side_m=SEGMENT_M
                )
                known = np.isfinite(patches[:, 0, 0])
                if known.any():
                    scaled = self.net(torch.from_numpy(patches[known]).to(self.device)).cpu().numpy().astype(np.float64)
                    out[part][known] = scaled * robot.nominal_voltage_v / SEGMENT_M - robot.hotel_per_m
        price, level = robot.price_per_m(out), robot.hotel_per_m + robot.weight_n * robot.rolling_resistance
        return out, segment_std(price, USUAL_SPREAD, level, factor=self.spread.factor)
