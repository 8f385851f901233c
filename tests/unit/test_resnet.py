"""The paper's network: torchvision's names and shapes, its parameter count, loading, and the energy it answers."""

import math

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from joulemap.model.energy.architectures.resnet18 import ResNet18, ResNet18Backbone, ResNetEnergy, load_backbone
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.learned import Facts
from joulemap.model.energy.segment_predictor import SegmentPredictor
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches


def torchvision_resnet18() -> dict[str, tuple[int, ...]]:
    """Names and shapes of torchvision's resnet18 without fc, typed in as the rules that generate them."""
    shapes: dict[str, tuple[int, ...]] = {}

    def norm(name: str, width: int) -> None:
        for part in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{part}"] = (width,)
        shapes[f"{name}.num_batches_tracked"] = ()

    shapes["conv1.weight"] = (64, 3, 7, 7)
    norm("bn1", 64)
    before = 64
    for layer, width in enumerate((64, 128, 256, 512), start=1):
        for block in (0, 1):
            stem = f"layer{layer}.{block}"
            shapes[f"{stem}.conv1.weight"] = (width, before, 3, 3)
            norm(f"{stem}.bn1", width)
            shapes[f"{stem}.conv2.weight"] = (width, width, 3, 3)
            norm(f"{stem}.bn2", width)
            if block == 0 and layer > 1:
                shapes[f"{stem}.downsample.0.weight"] = (width, before, 1, 1)
                norm(f"{stem}.downsample.1", width)
            before = width
    return shapes


def test_names_and_shapes_are_torchvisions():
    ours = {key: tuple(value.shape) for key, value in ResNet18Backbone().state_dict().items()}
    assert ours == torchvision_resnet18()


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_an_imagenet_file_loads_but_for_its_classifier(tmp_path, suffix):
    torch.manual_seed(1)
    given = ResNet18Backbone()
    state = dict(given.state_dict()) | {"fc.weight": torch.zeros(1000, 512), "fc.bias": torch.zeros(1000)}
    path = tmp_path / f"resnet18{suffix}"
    if suffix == ".pth":
        torch.save(state, path)
    else:
        save_file(state, path)
    loaded = load_backbone(path)
    assert all(
        torch.equal(a, b) for a, b in zip(given.state_dict().values(), loaded.state_dict().values(), strict=True)
    )


def test_a_file_that_does_not_fit_is_refused(tmp_path):
    state = dict(ResNet18Backbone().state_dict())
    del state["layer3.0.conv1.weight"]
    torch.save(state, tmp_path / "short.pth")
    (tmp_path / "noise.pth").write_bytes(b"not a file of weights")
    with pytest.raises(ModelError, match=r"layer3\.0\.conv1"):
        load_backbone(tmp_path / "short.pth")
    with pytest.raises(ModelError, match="torchvision"):
        load_backbone(tmp_path / "noise.pth")
    with pytest.raises(ModelError, match="no weights file"):
        load_backbone(tmp_path / "absent.pth")


def test_price_gives_the_networks_energy_back_and_the_lattice_is_made_of_segments():
    torch.manual_seed(0)
    net = ResNetEnergy().eval()
    net.target_mean.fill_(4.0)  # 4 A s at 28.8 V: above the hotel load of 24 J
    net.target_scale.fill_(0.1)
    frame = GridFrame(0.0, 6.0, 0.1, 60, 60)
    heights = 300.0 + 0.05 * np.random.default_rng(0).standard_normal(frame.shape)
    heights[5, 5] = math.nan
    heightmap = Heightmap(heights.astype(np.float32), frame)
    robot = Robot()
    predictor = SegmentPredictor(ResNet18(), net, Facts(Domain({}, (0.05, 1.0), 30.0), 32, "paper"))
    cells = frame.respaced(1.0).window(0, 4, 0, 4)
    headings = heading_bins(4)
    lattice = predictor.traction_per_m(heightmap, robot, cells, headings)
    assert lattice.shape == (4, 4, 4)
    assert np.isnan(lattice[0, 0]).all()
    x, y = cells.xy(2, 3)
    patch = cut_patches(heightmap, x - 0.5, y, math.pi / 2, size=32)  # p lies half a metre west of the centre
    with torch.inference_mode():
        scaled = float(net(torch.from_numpy(patch))[0])
    assert robot.price_per_m(lattice[2, 3, 1]) == pytest.approx(scaled * robot.nominal_voltage_v, rel=1e-5)
