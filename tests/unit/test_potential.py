"""The evened-out surface: a bound that noise in the heights does not spoil, and loops that are proven to pay."""

import numpy as np
import pytest

from joulemap.model.errors import NegativeCycleError
from joulemap.model.robot import Robot
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.pricing.potential import even_surface, spare_per_m
from tests.reference.lattices import plane_lattice

GENTLE = Robot(rolling_resistance=0.1, idle_power_w=0.0)


def noisy_plane(rng: np.random.Generator, noise_m: float) -> CostLattice:
    """Prices of a smooth plane, unclipped, over elevations that are off by a few centimetres."""
    lattice = plane_lattice(40, 40, 0.03, 0.05, robot=GENTLE)
    lattice.elevation_m[:] += rng.normal(0.0, noise_m, lattice.frame.shape).astype(np.float32)
    return lattice


def test_noise_in_the_heights_costs_the_bound_little():
    """On a plane the climb is exact: m g mu is left per metre (science: the climb telescopes), whatever the noise."""
    lattice = noisy_plane(np.random.default_rng(0), 0.05)
    exact = GENTLE.weight_n * GENTLE.rolling_resistance
    table = move_table(lattice)
    assert table.bound_per_m[-1] == pytest.approx(exact, rel=0.05)
    assert table.bound_per_m[-1] <= exact * (1 + 1e-6)
    raw = spare_per_m(table.energy, table.offsets, table.length_m, GENTLE.weight_n * lattice.elevation_m.astype(float))
    assert raw.min() < 0.0  # what the elevation itself would have left


def test_every_move_costs_its_rise_and_the_bound():
    lattice = noisy_plane(np.random.default_rng(1), 0.1)
    table = move_table(lattice)
    for share, bound in zip(table.rise_share, table.bound_per_m, strict=True):
        for n, (d_row, d_col) in enumerate(table.offsets):
            ends = np.roll(table.surface, (-d_row, -d_col), axis=(0, 1))
            spare = table.energy[..., n] - share * (ends - table.surface) - bound * table.length_m[n]
            assert np.nanmin(spare) >= -1e-6


def loop_of_four(saving: float) -> np.ndarray:
    """(4, 4, 4) moves north, east, south, west at 1 J; round the middle four cells clockwise one returns `saving`."""
    energy = np.full((4, 4, 4), np.nan, dtype=np.float32)
    energy[1:, :, 0] = energy[:, :-1, 1] = energy[:-1, :, 2] = energy[:, 1:, 3] = 1.0
    energy[1, 1, 1] -= saving
    return energy


def test_a_loop_that_returns_more_than_it_costs_is_named_and_one_that_does_not_is_no_hindrance():
    offsets = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]])
    flat = np.zeros((4, 4))
    surface = even_surface(loop_of_four(1.9), offsets, np.ones(4), flat)  # there and straight back: 0.1 J
    assert spare_per_m(loop_of_four(1.9), offsets, np.ones(4), surface).min() >= -1e-8
    with pytest.raises(NegativeCycleError) as error:
        even_surface(loop_of_four(2.1), offsets, np.ones(4), flat)
    assert (error.value.context["row"], error.value.context["col"]) in {(1, 1), (1, 2)}
