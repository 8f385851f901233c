"""Predictions are right on average: sums of runs that were left out, and losses whose minimum is the mean."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from joulemap.model.energy.architectures import find_architecture
from joulemap.model.energy.architectures.compact.net import CompactNet
from joulemap.model.energy.architectures.resnet18 import ResNetEnergy
from joulemap.model.energy.mean_level import mean_level
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.energy.robot_features import FEATURES
from joulemap.model.energy.tensors import NetworkOutput
from joulemap.model.loop.calibrate import _levelled, calibrate
from joulemap.model.training.optimisation import TrainingOptions, _Trainer
from tests.loop.calibrator import segments_of
from tests.loop.sums import case_of
from tests.reference.drives import made_up, measured_on, noisy


def runs_of(ratio: float, *, spread: float, count: int = 8):
    rng = np.random.default_rng(1)
    predicted = rng.uniform(50.0, 150.0, 40 * count)
    run = np.arange(40 * count) // 40
    factors = ratio * (1.0 + spread * np.resize([-1.0, 1.0], count))
    return predicted * factors[run] * rng.uniform(0.9, 1.1, predicted.size), predicted, run


def test_sums_that_agree_within_their_error_are_left_alone():
    energy, predicted, run = runs_of(1.02, spread=0.05)
    level = mean_level(energy, predicted, run)
    assert level.ratio == pytest.approx(energy.sum() / predicted.sum())
    assert level.std == pytest.approx(0.05 / np.sqrt(8), rel=0.3)
    assert level.factor == 1.0


def test_sums_that_do_not_agree_are_made_to():
    energy, predicted, run = runs_of(1.10, spread=0.02)
    assert mean_level(energy, predicted, run).factor == pytest.approx(energy.sum() / predicted.sum())
    beside = mean_level(energy + 30.0, predicted + 30.0, run, beside=30.0)
    assert beside.factor == pytest.approx(energy.sum() / predicted.sum())


def test_one_run_alone_says_nothing():
    energy, predicted, _ = runs_of(1.5, spread=0.0)
    level = mean_level(energy, predicted, np.zeros(energy.size))
    assert (level.factor, level.as_dict()["std"]) == (1.0, None)


@pytest.mark.parametrize("name", ["compact", "resnet18"])
def test_a_scaled_network_asks_for_a_multiple(name):
    torch.manual_seed(0)
    kind = find_architecture(name)
    if name == "resnet18":
        net = ResNetEnergy()
        net.target_mean, net.target_scale = torch.tensor(3.0), torch.tensor(0.5)
        given = (torch.rand(2, 64, 64),)
    else:
        net = CompactNet()
        torch.nn.init.normal_(net.gains.weight)
        torch.nn.init.normal_(net.rest.weight)
        size = kind.input_size(None)
        given = (torch.rand(2, size, size), torch.rand(2, len(FEATURES)), torch.rand(2, 2 * net.config.order + 1))
        given = (*given, torch.rand(2, net.tracks.in_features), torch.rand(2), torch.rand(2))
    net.eval()
    with torch.no_grad():
        plain, scaled = net(*given), kind.scaled(net, 1.3).eval()(*given)
    if name == "compact":
        plain, scaled = plain[0], scaled[0]
    torch.testing.assert_close(scaled, 1.3 * plain)


def test_disturbances_that_only_cost_more_are_in_the_sum():
    """5 % of the metres take 30 to 100 % more. A fit to the median leaves 3 % out."""
    case = case_of(2, 300, runs=6, length_m=120.0)[1]
    segments = segments_of(case.new.logs, case.declared)
    rows, electric, _ = residuals_on(PhysicsPredictor(), case.new.site.heightmap, case.declared, segments)
    said = calibrate(rows, electric=electric, cross_validate=False).held_out["after_planner"]
    assert said[rows.moving].sum() == pytest.approx(rows.measured[rows.moving].sum(), rel=0.005)


def test_a_training_finds_the_mean_of_skewed_energies():
    """The loss of a network that says the same of every metre is least where it says the mean."""
    energy = torch.from_numpy(np.random.default_rng(0).lognormal(3.0, 0.4, 4000).astype(np.float32))
    ones = torch.ones_like(energy)
    trainer = object.__new__(_Trainer)
    trainer.options = TrainingOptions()
    trainer.data = SimpleNamespace(measured=energy, hotel=ones, weight=ones, rolling=ones)
    said = torch.tensor(1.2 * float(energy.mean()), requires_grad=True)
    for _ in range(400):
        loss = trainer._loss(NetworkOutput(said.expand(energy.size(0)), energy, None), torch.arange(energy.size(0)))
        (slope,) = torch.autograd.grad(loss, said)
        said = (said - 20.0 * slope).detach().requires_grad_()
    assert said.item() == pytest.approx(float(energy.mean()), rel=0.005)


@pytest.mark.parametrize("few", [False, True])
def test_a_factor_that_makes_metres_worse_is_not_applied(few):
    """Sums are a fifth too high: of all metres, or of all but a few that take most of the energy."""
    rng = np.random.default_rng(4)
    rows = made_up(rng)
    energy = noisy(rng, rows, share=0.02)
    if few:  # every fiftieth metre takes ten times as much, of which nine tenths are predicted
        energy[::50] *= 10.0
    said = energy * 1.3
    if few:
        said[::50] *= 0.9 / 1.3
    measured = measured_on(rows, energy)
    level, held = _levelled(measured, said, measured.folds())
    assert not level.agrees
    assert (level.factor == 1.0) == few
    assert np.sum((held - energy) ** 2) <= np.sum((said - energy) ** 2)
