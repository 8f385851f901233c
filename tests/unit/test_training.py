"""Training: it learns what is there, repeats itself, resumes, holds out whole runs, and its errors are the paper's."""

import math

import numpy as np
import pytest
import torch

from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.architectures.resnet18 import ResNetEnergy
from joulemap.model.energy.examples import cut_examples
from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.tensors import ExampleTensors, predicted
from joulemap.model.energy.uncertainty import Spread, fit_spread
from joulemap.model.errors import InputError, ModelError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import coverage, errors
from joulemap.model.training.optimisation import TrainingOptions, averaged, train_network

ROBOT = Robot(rolling_resistance=0.1)
SHORT = TrainingOptions(epochs=3, patience=9, batch=64, learning_rate=2e-3)


def hilly(seed: int = 0) -> Heightmap:
    rng = np.random.default_rng(seed)
    frame = GridFrame(0.0, 24.0, 0.1, 240, 240)
    x, y = (a * 2 * math.pi for a in np.meshgrid(np.arange(240) / 240, np.arange(240) / 240))
    heights = 0.6 * np.sin(x) + 0.5 * np.cos(2 * y + x) + 0.01 * rng.standard_normal(frame.shape)
    return Heightmap(heights.astype(np.float32), frame)


def driven(count: int, *, loss: float = 1.4, architecture: str = "compact", seed: int = 1):
    """Segments of a made-up truth: eq. 5 with rolling losses `loss` times what the robot's owner believes."""
    rng = np.random.default_rng(seed)
    heightmap = hilly()
    x, y = rng.uniform(2.0, 22.0, (2, count))
    heading = rng.uniform(0.0, 2 * math.pi, count)
    grade = tan_grade(heightmap, x, y, heading)
    energy = ROBOT.price_per_m(ROBOT.weight_n * (loss * ROBOT.rolling_resistance + grade))
    run = np.arange(count) * 8 // count
    examples = cut_examples(heightmap, ROBOT, x, y, heading, energy, run=run, architecture=architecture, size=32)
    return heightmap, (x, y, heading, energy, run), examples


def test_learns_a_loss_that_physics_underrates():
    _, _, examples = driven(400)
    options = TrainingOptions(epochs=30, patience=30, batch=64, learning_rate=3e-3)
    result = train_network(examples, seed=3, options=options)
    before = TrainingOptions(epochs=0)
    untrained = train_network(examples, seed=3, options=before).held_out_error
    assert result.held_out_error < 0.2 * untrained
    held = examples.select(np.isin(examples.run, result.held_out_runs))
    measured = errors(predicted(result.net, held)[0], held.energy_j, held.run)
    assert measured["mean_relative_error"] == pytest.approx(result.held_out_error, rel=0.05)


def same_weights(one: Network, other: Network) -> bool:
    pairs = zip(one.state_dict().values(), other.state_dict().values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def test_same_seed_same_weights_and_resuming_changes_nothing(tmp_path):
    _, _, examples = driven(120)

    class Stopped(Exception):
        pass

    def stop_after_one(done: float) -> None:
        raise Stopped

    def train(seed=5, **kwargs):
        return train_network(examples, seed=seed, options=SHORT, **kwargs).net

    reference = train()
    checkpoint = tmp_path / "state.pt"
    with pytest.raises(Stopped):
        train(checkpoint=checkpoint, progress=stop_after_one)
    assert same_weights(reference, train())
    assert same_weights(reference, train(checkpoint=checkpoint))
    assert not same_weights(reference, train(seed=6))
    with pytest.raises(ModelError, match="another training"):
        train(seed=6, checkpoint=checkpoint)


def test_a_last_patch_alone_is_no_batch():
    _, _, examples = driven(6, architecture="resnet18")  # 32 x 32 patches end as one value per channel
    options = TrainingOptions(epochs=1, batch=2, learning_rate=1e-4)
    train_network(examples, architecture="resnet18", held_out_runs=[6], options=options)


def test_whole_runs_are_held_out():
    _, _, examples = driven(80)
    result = train_network(examples, held_out_runs=[2, 5], options=TrainingOptions(epochs=1))
    assert result.held_out_runs == [2, 5]
    with pytest.raises(InputError, match="at least two runs"):
        train_network(examples.select(examples.run == 0), options=SHORT)


def test_training_turns_the_ground_and_the_heading_together():
    # on the plane z = 0.3 x a robot heads 20 degrees west of uphill; turned clockwise uphill is south
    heading = math.radians(90.0 - 20.0)
    frame = GridFrame(0.0, 6.0, 0.125, 48, 48)
    x, _ = frame.centres()
    east = Heightmap(np.tile(0.3 * x, (48, 1)).astype(np.float32), frame)
    south = Heightmap(np.tile(0.3 * x[:, None], (1, 48)).astype(np.float32), frame)
    west = Heightmap(np.tile(-0.3 * x, (48, 1)).astype(np.float32), frame)
    one, turned, mirrored = (
        cut_examples(heightmap, ROBOT, [3.0], [3.0], [h], [1.0])
        for heightmap, h in ((east, heading), (south, heading + math.pi / 2), (west, -heading))
    )
    torch.manual_seed(0)
    net = train_network(driven(80)[2], options=TrainingOptions(epochs=1, learning_rate=1e-2)).net
    part = torch.arange(1)
    with torch.inference_mode():
        for told, cut_anew in (({"quarter_turns": 1}, turned), ({"mirror": True}, mirrored)):
            as_told = ExampleTensors(one).answer(net, part, leak=0.0, **told).energy
            expected = ExampleTensors(cut_anew).answer(net, part, leak=0.0).energy
            assert float(as_told) == pytest.approx(float(expected), rel=1e-4)


def test_fine_tuning_starts_from_what_is_known_and_leaves_it_alone():
    _, _, examples = driven(400)
    options = TrainingOptions(epochs=15, patience=15, batch=64, learning_rate=3e-3)
    known = train_network(examples, options=options)
    kept = {key: value.clone() for key, value in known.net.state_dict().items()}
    tuned = train_network(examples, start_from=known.net, options=TrainingOptions(epochs=1, learning_rate=1e-4))
    assert tuned.held_out_error <= known.held_out_error + 1e-9
    assert all(torch.equal(kept[key], value) for key, value in known.net.state_dict().items())
    with pytest.raises(ModelError):
        train_network(examples, architecture="compact", start_from=ResNetEnergy(), options=SHORT)


def test_errors_by_hand():
    # |10-8|/8 = 0.25, |5-5|/5 = 0, |6-12|/12 = 0.5; runs: |15-13|/13 and |6-12|/12
    found = errors([10.0, 5.0, 6.0], [8.0, 5.0, 12.0], [1, 1, 2])
    assert found["segments"] == 3
    assert found["mean_relative_error"] == pytest.approx(0.25)
    assert found["median_relative_error"] == pytest.approx(0.25)
    assert found["rmse_j"] == pytest.approx(math.sqrt((4 + 0 + 36) / 3))
    assert found["bias_j"] == pytest.approx((-2 + 0 + 6) / 3)
    assert found["route_relative_errors"] == {"1": pytest.approx(2 / 13), "2": pytest.approx(0.5)}
    assert found["route_relative_error"] == pytest.approx((2 / 13 + 0.5) / 2)


def test_the_mean_of_the_weights_is_the_mean_of_the_weights():
    _, _, examples = driven(200)
    start = train_network(examples, seed=1, options=SHORT).net
    nets = [train_network(examples, seed=s, start_from=start, options=SHORT).net for s in (2, 3)]
    mean = averaged(nets)
    for key, value in mean.state_dict().items():
        assert torch.allclose(value, (nets[0].state_dict()[key] + nets[1].state_dict()[key]) / 2)
    assert not same_weights(nets[0], mean)


def test_held_out_runs_choose_nothing_when_the_last_weights_are_kept():
    _, _, examples = driven(200)
    options = TrainingOptions(epochs=4, patience=1, batch=64, keep_last=True)
    one, other = (train_network(examples, seed=1, held_out_runs=[0], options=options) for _ in range(2))
    assert one.epochs == 4
    assert same_weights(one.net, other.net)
    assert one.held_out_error == one.history[-1]["held_out_error"]


def test_coverage_counts_what_lies_inside():
    spread = Spread(quantiles=(0.5, 1.0, 2.0))
    inside = coverage([10.0, 10.0, 10.0, 10.0], [10.0, 10.9, 11.5, 13.0], [1.0] * 4, spread)
    assert inside == {"50": 0.25, "80": 0.5, "90": 0.75}


def test_a_single_run_predicted_well_does_not_promise_that_of_the_next():
    predicted_j = np.full(100, 50.0)
    energy = predicted_j + np.tile([2.0, -2.0], 50)  # its sum is right to the joule
    assert fit_spread(energy, predicted_j, predicted_j * 0.1, np.zeros(100)).run_share == pytest.approx(
        Spread.run_share / math.sqrt(2.0)
    )


def test_a_spread_covers_what_it_was_made_for():
    rng = np.random.default_rng(0)
    run = np.repeat(np.arange(40), 200)
    predicted_j = rng.uniform(40.0, 200.0, run.size)
    of_run = np.exp(0.04 * rng.standard_normal(40))
    # Student's t with 5 degrees of freedom: tails that a normal distribution does not have
    std = 0.08 * predicted_j
    energy = predicted_j * of_run[run] + 1.3 * std * rng.standard_t(5, run.size) / math.sqrt(5 / 3)
    half = run < 20
    spread = fit_spread(energy[half], predicted_j[half], std[half], run[half])
    assert spread.run_share == pytest.approx(0.04, rel=0.4)
    for level, share in coverage(energy[~half], predicted_j[~half], spread.factor * std[~half], spread).items():
        assert share == pytest.approx(float(level) / 100.0, abs=0.025)
    sums = [(energy[run == k].sum() - predicted_j[run == k].sum()) for k in range(20, 40)]
    told = [spread.route_std(predicted_j[run == k], spread.factor * std[run == k])[-1] for k in range(20, 40)]
    assert np.std(np.array(sums) / np.array(told)) == pytest.approx(1.0, abs=0.4)
