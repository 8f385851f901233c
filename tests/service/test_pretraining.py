"""Pretraining data and the shipped network: repeatable, in range, sane on planes, better than physics."""

import json
import math
from importlib import resources

import numpy as np
import pytest

from joulemap.model.energy.artifact import read_artifact
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS, load_predictor
from joulemap.model.energy.robot_features import FEATURES
from joulemap.model.energy.tensors import predicted
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import errors
from joulemap.model.training.optimisation import TrainingOptions
from joulemap.model.training.pretraining import baselines, train_default
from joulemap.model.training.simulated_set import MU_RANGE, ROBOTS_PER_SITE, make_pretraining_set

WEIGHTS = resources.files("joulemap.model") / "weights"
SMALL = Robot(mass_kg=20.0, width_m=0.4, length_m=0.45, wheel_radius_m=0.1, speed_mps=0.8, rolling_resistance=0.06)
LARGE = Robot(mass_kg=70.0, width_m=0.65, length_m=0.9, wheel_radius_m=0.15, rolling_resistance=0.14)


@pytest.fixture(scope="module")
def shipped():
    return load_predictor("default")


@pytest.fixture(scope="module")
def fresh():
    """Sites that no training has seen: their seed is not the shipped network's."""
    return make_pretraining_set(sites=4, seed=987654)


def plane(slope_deg: float, uphill_rad: float, resolution_m: float = 0.1) -> Heightmap:
    cells = round(8.0 / resolution_m)
    frame = GridFrame(0.0, 8.0, resolution_m, cells, cells)
    x, y = frame.centres()
    rise = math.tan(math.radians(slope_deg))
    heights = rise * (math.sin(uphill_rad) * x[None, :] + math.cos(uphill_rad) * y[:, None])
    return Heightmap(heights.astype(np.float32), frame)


def price(predictor, heightmap: Heightmap, robot: Robot, heading_rad) -> np.ndarray:
    return robot.price_per_m(predictor.segment_traction(heightmap, robot, 4.0, 4.0, heading_rad))


def test_the_same_seed_makes_the_same_data(fresh):
    first = fresh.select(fresh.run < ROBOTS_PER_SITE)
    assert make_pretraining_set(sites=1, seed=987654).data_hash == first.data_hash
    assert make_pretraining_set(sites=1, seed=987655).data_hash != first.data_hash
    mu = fresh.features[:, FEATURES.index("rolling_resistance")]
    assert mu.min() >= MU_RANGE[0] - 1e-6
    assert mu.max() <= MU_RANGE[1] + 1e-6
    assert np.unique(fresh.run).size == 4 * ROBOTS_PER_SITE


def test_a_small_pretraining_writes_a_model_that_loads(tmp_path):
    options = TrainingOptions(epochs=1, batch=256)
    told = train_default(tmp_path / "mine", sites=3, seed=1, workers=1, options=options)
    model = load_predictor(tmp_path / "mine")
    assert model.provenance()["version"] == told["version"]
    assert model.provenance()["config"]["training"]["data_hash"] == told["data_hash"]
    assert set(told["baselines"]) == {"physics_declared", "physics_fitted_to_each_run"}
    json.dumps(told)


def test_shipped_files_agree_with_each_other_and_with_the_card():
    config = json.loads((WEIGHTS / "config.json").read_text())
    card = (WEIGHTS / "MODEL_CARD.md").read_text()
    training = config["training"]
    assert len((WEIGHTS / "weights.safetensors").read_bytes()) < 2_000_000
    assert config["version"] in card
    assert training["data_hash"] in card
    for found in (training["held_out"], *training["baselines"].values()):
        assert f"{100 * found['mean_relative_error']:.1f} %" in card
        assert training["held_out"]["mean_relative_error"] <= found["mean_relative_error"]


def test_shipped_network_beats_physics_on_unseen_sites(fresh):
    judged = fresh.select(fresh.regeneration == 0.0)
    net = read_artifact(str(SHIPPED_WEIGHTS)).net
    ours = errors(predicted(net, judged)[0], judged.energy_j, judged.run)["mean_relative_error"]
    for name, theirs in baselines(judged).items():
        assert ours < 0.85 * theirs["mean_relative_error"], name


def test_shipped_network_covers_what_is_promised(shipped):
    # slopes to 30 degrees, heightmaps from 0.05 to 1 m per pixel
    for resolution in (0.05, 1.0):
        assert shipped.warnings(plane(28.0, 0.0, resolution), Robot()) == []
    told = shipped.warnings(plane(35.0, 0.0, 2.0), Robot(mass_kg=300.0))
    assert len(told) >= 3
    assert any("mass_kg = 300" in words for words in told)
    assert any("2 m/pixel" in words for words in told)
    assert any("steeper than the 30 degrees" in words for words in told)


@pytest.mark.parametrize("robot", [Robot(), SMALL, LARGE], ids=["default", "small", "large"])
@pytest.mark.parametrize("resolution_m", [0.05, 0.1, 0.25, 1.0])
def test_level_ground_costs_about_what_the_declared_resistance_says(shipped, robot, resolution_m):
    level = plane(0.0, 0.0, resolution_m)
    got = price(shipped, level, robot, heading_bins(16))
    expected = price(PhysicsPredictor(), level, robot, 0.0)
    # the resistance was declared for ground that is even and not a plane: where bumps would be seen, a plane costs less
    assert got.mean() == pytest.approx(float(expected[0]), rel=0.35 if resolution_m == 1.0 else 0.2)
    assert got.std() < 0.06 * got.mean()


@pytest.mark.parametrize("robot", [Robot(), SMALL, LARGE], ids=["default", "small", "large"])
@pytest.mark.parametrize("slope_deg", [5.0, 10.0, 15.0, 20.0, 25.0])
def test_planes_of_every_direction(shipped, robot, slope_deg):
    level = price(shipped, plane(0.0, 0.0), robot, heading_bins(12)).mean()
    directions = heading_bins(12)
    up, down = (
        np.concatenate([price(shipped, plane(slope_deg, h), robot, h + turn) for h in directions])
        for turn in (0.0, math.pi)
    )
    assert down.max() < level < up.min()
    assert up.std() < 0.04 * up.mean()  # a plane costs the same whichever way it faces
    physics = price(PhysicsPredictor(), plane(slope_deg, 0.0), robot, 0.0)[0]
    assert physics < up.mean() < 1.8 * physics  # a drivetrain's losses come on top of the climb


def test_rough_ground_mirrored_and_turned(shipped):
    rng = np.random.default_rng(5)
    frame = GridFrame(0.0, 12.0, 0.1, 120, 120)
    coarse = rng.standard_normal((24, 24)).repeat(5, axis=0).repeat(5, axis=1)
    heights = (0.02 * coarse + 0.015 * rng.standard_normal(frame.shape)).astype(np.float32)
    cells, headings, robot = frame.respaced(1.0), heading_bins(16), Robot()

    def prices(z: np.ndarray) -> np.ndarray:
        return robot.price_per_m(shipped.traction_per_m(Heightmap(z, frame), robot, cells, headings))

    straight = prices(heights)
    mirrored = prices(heights[:, ::-1])[:, ::-1][:, :, -np.arange(16) % 16]
    turned = np.rot90(prices(np.rot90(heights, -1)), 1)[:, :, (np.arange(16) + 4) % 16]
    assert np.abs(mirrored - straight).mean() < 0.06 * straight.mean()
    assert np.abs(turned - straight).mean() < 0.06 * straight.mean()
    assert straight.mean() > 1.2 * float(price(shipped, plane(0.0, 0.0), robot, 0.0)[0])
