"""Every architecture keeps the contract: saved and read it answers the same, and its lattice is made of segments."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from joulemap.model.energy.architectures import ARCHITECTURES, DEFAULT_ARCHITECTURE, find_architecture
from joulemap.model.energy.artifact import Artifact, load_artifact, read_artifact, save_artifact
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.examples import cut_examples
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS
from joulemap.model.energy.tensors import CPU, ExampleTensors
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.optimisation import TrainingOptions, train_network

ROBOT = Robot()
DOMAIN = Domain({"mass_kg": (15.0, 120.0)}, (0.05, 1.0), 30.0)
SIZE = 32


def rough() -> Heightmap:
    frame = GridFrame(0.0, 8.0, 0.1, 80, 80)
    return Heightmap((0.05 * np.random.default_rng(0).standard_normal(frame.shape)).astype(np.float32), frame)


def artifact(name: str) -> Artifact:
    """A network of random weights."""
    kind = find_architecture(name)
    torch.manual_seed(0)
    size = kind.input_size(SIZE)
    net = kind.build({}, size=size)
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    return Artifact(net.eval(), DOMAIN, size)


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_saved_and_read_it_answers_the_same(name: str, tmp_path: Path) -> None:
    made = artifact(name)
    save_artifact(tmp_path, made)
    read = read_artifact(tmp_path)
    kind = find_architecture(name)
    assert (read.architecture, read.size) == (name, made.size)
    assert kind.config_of(read.net) == kind.config_of(made.net)
    examples = cut_examples(rough(), ROBOT, [3.0, 4.0], [3.0, 4.0], [0.0, 1.0], 80.0, architecture=name, size=made.size)
    with torch.inference_mode():
        one, other = (
            ExampleTensors(examples).answer(net, torch.arange(2), leak=0.0).energy for net in (made.net, read.net)
        )
    assert torch.equal(one, other)


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_a_lattice_is_made_of_segments(name: str, tmp_path: Path) -> None:
    save_artifact(tmp_path, artifact(name))
    model = load_artifact(tmp_path)
    frame = rough().frame.respaced(1.0).window(2, 4, 3, 6)
    headings = heading_bins(4)
    lattice, std = model.traction_and_std(rough(), ROBOT, frame, headings)
    x, y = frame.centres()
    places = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    single, single_std = model.segment_traction_and_std(rough(), ROBOT, *places)
    np.testing.assert_allclose(lattice.ravel(), single, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(std.ravel(), single_std, rtol=1e-3)


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_a_frozen_backbone_is_the_only_part_that_training_leaves(name: str) -> None:
    kind, made = find_architecture(name), artifact(name)
    x, y = np.random.default_rng(1).uniform(2.0, 6.0, (2, 8))
    energy, run = 80.0 + 5.0 * np.arange(8), np.arange(8) // 4
    examples = cut_examples(rough(), ROBOT, x, y, 0.0, energy, run=run, architecture=name, size=made.size)
    options = TrainingOptions(epochs=1, batch=4, learning_rate=1e-2, freeze_backbone=True, keep_last=True)
    net = train_network(examples, architecture=name, start_from=made.net, options=options).net
    before = dict(made.net.named_parameters())
    changed = {key for key, value in net.named_parameters() if not torch.equal(value, before[key])}
    frozen = kind.backbone_of(net)
    assert changed
    if frozen is not None:
        assert not {f"backbone.{key}" for key, _ in frozen.named_parameters()} & changed


def test_only_an_architecture_with_a_backbone_reads_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the architecture compact has no backbone"):
        find_architecture("compact").from_backbone(tmp_path / "weights.pth")
    assert find_architecture("compact").device() == CPU


def test_the_shipped_weights_are_of_the_default_architecture_and_their_version() -> None:
    read = read_artifact(str(SHIPPED_WEIGHTS))
    assert (read.architecture, read.size) == (DEFAULT_ARCHITECTURE, 17)
    assert load_artifact(str(SHIPPED_WEIGHTS)).provenance()["version"] == "24b5d5f5e64ae1f3"


def test_the_names_are_known_without_torch_or_numpy() -> None:
    code = (
        "import sys; from joulemap.model.energy.architectures import ARCHITECTURES; "
        "print([m for m in ('torch', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_shipped_network_is_asked_without_torch() -> None:
    """Loading torch takes longer than pricing a small map."""
    code = """
import sys
import numpy as np
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
ground, model = Heightmap(np.zeros((40, 40), np.float32), GridFrame(0.0, 10.0, 0.25, 40, 40)), load_predictor("default")
price = model.traction_per_m(ground, Robot(), ground.frame.respaced(1.0), heading_bins(8))
single = model.segment_traction(ground, Robot(), [5.5], [5.5], [0.0])
print(np.isfinite(price).all() and np.isfinite(single).all(), "torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]
