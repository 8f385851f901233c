"""Areas to avoid: their cells are blocked for the question that names them, and for no other."""

from pathlib import Path

import numpy as np
import pytest

from joulemap.model.errors import BlockedError, InputError, NoRouteError, PointError
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.folder import save_lattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner
from tests.reference.lattices import ascii_lattice, random_lattice

MEADOW = """
    ..........
    ..........
    .a......b.
    ..........
    ..........
"""


def test_a_route_goes_around_and_the_next_question_does_not() -> None:
    lattice, at = ascii_lattice(MEADOW)
    planner = RoutePlanner(lattice)
    post = [[(4.2, 2.2), (5.8, 2.2), (5.8, 2.8), (4.2, 2.8)]]
    around = planner.avoiding(post).plan(at["a"], at["b"])
    assert around.route.length_m > 7.4
    assert np.abs(around.route.points[:, 1] - 2.5).max() > 0.9
    assert planner.plan(at["a"], at["b"]).route.length_m == pytest.approx(7.0)


def test_a_fence_thinner_than_a_cell_has_no_gap() -> None:
    lattice, at = ascii_lattice(MEADOW)
    fence = [[(3.0, -1.0), (3.01, -1.0), (6.01, 6.0), (6.0, 6.0)]]
    with pytest.raises(NoRouteError):
        RoutePlanner(lattice).avoiding(fence).plan(at["a"], at["b"])


@pytest.mark.parametrize("seed", range(4))
def test_moves_priced_again_near_the_areas_are_those_of_a_new_planner(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 40, 50, turn_j_per_rad=float(seed % 2) * 20.0)
    planner = RoutePlanner(lattice)
    for _ in range(2):  # the second one begins from the whole map again
        west, south = rng.uniform((100.0, 160.0), (140.0, 190.0))
        areas = [
            [(west, south), (west + 12.0, south + 2.0), (west + 5.0, south + 9.0)],
            [(99, 161), (103, 161), (99, 170)],
        ]
        other = planner.avoiding(areas)
        table = RoutePlanner(other.lattice)._table(32, distance=False)
        np.testing.assert_array_equal(other._table(32, distance=False).energy, table.energy)
        assert planner.avoiding(areas) is other
        assert (other.lattice.blocked == Blocked.AVOID).sum() > 40
    assert not (lattice.blocked == Blocked.AVOID).any()


def test_a_map_on_disk_avoids_the_same_cells(tmp_path: Path) -> None:
    lattice, at = ascii_lattice(MEADOW)
    save_lattice(lattice, tmp_path / "meadow.zarr")
    post = [[(4.2, 1.2), (5.8, 1.2), (5.8, 3.8), (4.2, 3.8)]]
    stored = StoredPlanner(tmp_path / "meadow.zarr")
    there = stored.avoiding(post).plan(at["a"], at["b"]).route
    assert there.length_m == pytest.approx(RoutePlanner(lattice).avoiding(post).plan(at["a"], at["b"]).route.length_m)
    assert stored.plan(at["a"], at["b"]).route.length_m == pytest.approx(7.0)


def test_places_in_an_area_and_areas_that_are_none_are_refused_in_words() -> None:
    lattice, at = ascii_lattice(MEADOW)
    planner = RoutePlanner(lattice)
    around_a = [[(0.0, 1.0), (3.0, 1.0), (3.0, 4.0), (0.0, 4.0)]]
    with pytest.raises(BlockedError, match="avoid") as refused:
        planner.avoiding(around_a).plan(at["a"], at["b"])
    assert refused.value.context["reason"] == "avoid"
    with pytest.raises(InputError, match="area 0 has 2 corners"):
        planner.avoiding([[(0.0, 0.0), (1.0, 1.0)]])
    with pytest.raises(PointError, match=r"area 1 .* lies outside the map"):
        planner.avoiding([around_a[0], [(20.0, 0.0), (30.0, 0.0), (30.0, 9.0)]])
    with pytest.raises(PointError, match="not a finite number"):
        planner.avoiding([[(0.0, 0.0), (1.0, float("nan")), (2.0, 0.0)]])
    with pytest.raises(InputError, match="at most 20000"):
        planner.avoiding([[(0.0, 0.0)] * 20_001])
