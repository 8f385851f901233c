"""Going over to a changed map gives the answers of planning anew on it, however often it changes."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import BlockedError, NegativeCycleError, NoRouteError
from joulemap.planner.grid.fields import field_towards
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.questions.replan import Replanner, changed_window
from tests.reference.lattices import random_lattice


def other_ground(rng, lattice):
    """The same lattice with a window of dearer or cheaper ground, other slopes, and cells blocked and freed."""
    rows, cols = lattice.frame.shape
    row0, col0 = rng.integers(0, rows - 2), rng.integers(0, cols - 2)
    part = np.s_[row0 : row0 + rng.integers(1, 6), col0 : col0 + rng.integers(1, 6)]
    traction, blocked = lattice.traction_per_m.copy(), lattice.blocked.copy()
    traction[part] = (traction[part] * rng.choice([0.7, 1.0, 1.5])).astype(np.float32)
    blocked[part] = np.where(rng.random(blocked[part].shape) < 0.3, 3 - blocked[part], blocked[part])
    return replace(lattice, traction_per_m=traction, blocked=blocked)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    turn=st.sampled_from([0.0, 0.0, 40.0]),
    regeneration=st.sampled_from([0.0, 0.0, 0.4]),
    neighbours=st.sampled_from([8, 16, 32]),
)
def test_a_changed_map_is_planned_as_anew(seed, turn, regeneration, neighbours):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 16, 18, turn_j_per_rad=turn, regeneration=regeneration)
    goals = rng.uniform(0.0, 15.0, (int(rng.integers(1, 3)), 2))
    try:
        replanner = Replanner(lattice, goals, neighbours=neighbours)
        for _ in range(3):
            lattice = other_ground(rng, lattice)
            replanner.change(lattice)
            anew = field_towards(lattice, move_table(lattice, neighbours=neighbours), goals)
            np.testing.assert_allclose(replanner.field.energy_j, anew.energy_j, rtol=1e-9, atol=1e-9)
            start = rng.uniform(0.0, 15.0, 2)
            try:
                path = replanner.path_from(start)
            except NoRouteError:
                continue
            np.testing.assert_allclose(path.energy_j, anew.path_from(start).energy_j, rtol=1e-9, atol=1e-9)
            assert path_price(lattice, path.points) <= path.energy_j * (1 + 1e-6) + 1e-3
    except (BlockedError, NegativeCycleError):  # a goal that no leg reaches, on this ground or on the next
        return


def test_nothing_changed_is_seen_and_costs_nothing():
    lattice = random_lattice(np.random.default_rng(1), 12, 12)
    same = replace(lattice, traction_per_m=lattice.traction_per_m.copy())
    assert changed_window(lattice, same) is None
    other = replace(lattice, blocked=lattice.blocked.copy())
    other.blocked[3:5, 7] = 3 - other.blocked[3:5, 7]
    assert changed_window(lattice, other) == (3, 5, 7, 8)
    assert Replanner(lattice, np.array([[6.0, 6.0]])).change(same) == 0
