"""Models as folders: what is saved comes back, what does not fit is refused, and what was learned is told."""

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save

from joulemap.model.energy.architectures.compact.net import CompactNet
from joulemap.model.energy.architectures.resnet18 import ResNetEnergy
from joulemap.model.energy.artifact import (
    CONFIG_FILE,
    WEIGHTS_FILE,
    Artifact,
    load_artifact,
    read_artifact,
    save_artifact,
)
from joulemap.model.energy.domain import Domain, steep_share
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.correction import Correction
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

ROBOTS = {"mass_kg": (15.0, 120.0), "speed_mps": (0.3, 1.2), "hotel_over_weight": (0.01, 0.3)}
DOMAIN = Domain(ROBOTS, (0.05, 1.0), 30.0)


def slope(angle_deg: float, resolution_m: float = 0.25, cells: int = 40) -> Heightmap:
    frame = GridFrame(0.0, cells * resolution_m, resolution_m, cells, cells)
    heights = np.tile(np.arange(cells) * resolution_m * math.tan(math.radians(angle_deg)), (cells, 1))
    return Heightmap(heights.astype(np.float32), frame)


@pytest.mark.parametrize("net", [CompactNet(), ResNetEnergy()], ids=["compact", "resnet18"])
def test_a_model_comes_back_from_its_folder(tmp_path, net):
    net = net.eval()
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    size = {} if isinstance(net, CompactNet) else {"size": 32}
    version = save_artifact(tmp_path / "mine", Artifact(net, DOMAIN, training={"seed": 7}, **size))
    loaded = load_predictor(tmp_path / "mine")
    assert loaded.name == "mine"
    assert loaded.domain == DOMAIN
    read = read_artifact(tmp_path / "mine").net.state_dict()
    assert all(torch.equal(a, read[key]) for key, a in net.state_dict().items())
    told = loaded.provenance()
    assert (told["version"], told["kind"]) == (version, "compact" if isinstance(net, CompactNet) else "resnet18")
    assert told["config"]["training"] == {"seed": 7}
    json.dumps(told)
    answer = loaded.segment_traction(slope(5.0), Robot(), [5.0], [5.0], [0.0])
    assert np.isfinite(answer).all()


def test_files_that_are_not_partners_are_refused(tmp_path):
    save_artifact(tmp_path / "a", Artifact(CompactNet(), DOMAIN))
    save_artifact(tmp_path / "b", Artifact(CompactNet(), DOMAIN))
    (tmp_path / "a" / WEIGHTS_FILE).write_bytes((tmp_path / "b" / WEIGHTS_FILE).read_bytes())
    with pytest.raises(ModelError, match="damaged or mixed"):
        load_artifact(tmp_path / "a")
    config = json.loads((tmp_path / "b" / CONFIG_FILE).read_text())
    (tmp_path / "b" / CONFIG_FILE).write_text(json.dumps(config | {"spread": {**config["spread"], "factor": 0.5}}))
    with pytest.raises(ModelError, match="is not what was written"):
        load_artifact(tmp_path / "b")
    del config["checksum"]  # as version 0.1 wrote it
    for key, value, words in (
        ("architecture", "forest", "unknown architecture"),
        ("size", 33, "this version 17"),
        ("format", 99, "model format"),
        ("domain", {}, "what it learned"),
        ("network", {"pixel_m": 0.125, "depth": 3}, "does not fit this version"),
        ("network", {"pixel_m": 0.125, "order": 5}, "the weights do not fit the network: series.weight has the shape"),
    ):
        (tmp_path / "b" / CONFIG_FILE).write_text(json.dumps(config | {key: value}))
        with pytest.raises(ModelError, match=words):
            load_artifact(tmp_path / "b")
    (tmp_path / "b" / CONFIG_FILE).write_text("{")
    with pytest.raises(ModelError, match="not valid JSON"):
        load_artifact(tmp_path / "b")
    (tmp_path / "b" / CONFIG_FILE).unlink()
    with pytest.raises(ModelError, match="not a trained model"):
        load_predictor(tmp_path / "b")


@pytest.mark.parametrize("data", [b"no weights", save({"a": torch.zeros(3, dtype=torch.bfloat16)})])
def test_weights_that_cannot_be_read_are_refused(tmp_path, data):
    save_artifact(tmp_path, Artifact(CompactNet(), DOMAIN))
    (tmp_path / WEIGHTS_FILE).write_bytes(data)
    config = json.loads((tmp_path / CONFIG_FILE).read_text()) | {"version": hashlib.sha256(data).hexdigest()[:16]}
    del config["checksum"]
    (tmp_path / CONFIG_FILE).write_text(json.dumps(config))
    with pytest.raises(ModelError, match=r"weights.safetensors cannot be read"):
        load_artifact(tmp_path)


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(ModelError, match="physics, default") as caught:
        load_predictor("phisics")
    assert caught.value.context["known"] == ["physics", "default"]


def test_warnings_name_the_value_and_the_limits():
    inside = Robot()
    assert DOMAIN.warnings(slope(10.0), inside) == []
    assert DOMAIN.warnings(slope(10.0), Robot(mass_kg=300.0)) == [
        "mass_kg = 300 is outside the 15..120 the network learned",
        "idle power / (speed x weight) = 0.00816 is outside the 0.01..0.3 the network learned",
    ]
    assert DOMAIN.warnings(slope(10.0, resolution_m=2.0), inside) == [
        "the heightmap's resolution of 2 m/pixel is outside the 0.05..1 the network learned"
    ]
    assert DOMAIN.warnings(slope(35.0), inside) == [
        "100 % of the map is steeper than the 30 degrees the network learned"
    ]


def test_a_model_of_measured_runs_warns_about_another_robot(tmp_path):
    runs_robot = Robot(name="fieldbot-7", mass_kg=68.0, speed_mps=0.8, rolling_resistance=0.1, idle_power_w=30.0)
    save_artifact(tmp_path / "mine", Artifact(CompactNet(), DOMAIN, training={"robot": runs_robot.as_dict()}))
    model, ground = load_artifact(tmp_path / "mine"), slope(10.0)
    words = "this robot is {}, but the model mine was trained with {}: give that robot's file, or expect errors"
    for other, now, then in (
        ({"mass_kg": 25.0, "name": "rover"}, "rover (25 kg)", "fieldbot-7 (68 kg)"),
        ({"rolling_resistance": 0.05}, "fieldbot-7 (rolling resistance 0.05)", "fieldbot-7 (rolling resistance 0.1)"),
        ({"idle_power_w": 0.0}, "fieldbot-7 (0 W idle)", "fieldbot-7 (30 W idle)"),
    ):
        assert model.warnings(ground, replace(runs_robot, **other))[0] == words.format(now, then)
        calibrated = CalibratedPredictor(model, Correction((), ()), name="found", version="1")
        assert calibrated.warnings(ground, replace(runs_robot, **other))[0] == words.format(now, then)
    legitimate = {"speed_mps": 0.5, "name": "x", "max_grade_deg": 10.0, "battery_wh": 9.0, "mass_kg": 68.0001}
    assert model.warnings(ground, replace(runs_robot, **legitimate)) == []


def test_share_of_steep_ground():
    half = slope(40.0).heights.copy()
    half[:, 20:] = half[:, 19:20]  # level from the middle on
    frame = slope(40.0).frame
    assert steep_share(Heightmap(half, frame), 30.0) == pytest.approx(0.5, abs=0.03)
    half = half.copy()
    half = half.copy()
    half[:, :20] = np.nan
    assert steep_share(Heightmap(half, frame), 30.0) == 0.0


def test_domains_join():
    other = Domain({"mass_kg": (100.0, 300.0)}, (0.5, 2.0), 12.0)
    joined = DOMAIN.joined(other)
    assert joined.robot["mass_kg"] == (15.0, 300.0)
    assert joined.robot["speed_mps"] == (0.3, 1.2)
    assert (joined.resolution_m, joined.max_slope_deg) == ((0.05, 2.0), 30.0)
    assert Domain.from_dict(json.loads(json.dumps(joined.as_dict()))) == joined
