"""Ways beside a path compete once each, and are searched again only where the path has changed."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.planner import beside
from joulemap.planner.beside import MOST_CELLS, with_ways_beside
from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import near_lines, stretches, subdivided
from joulemap.planner.ribbon import Ribbon
from tests.reference.lattices import ascii_lattice

ROWS, LINE = 41, 20


def channels(cols: int, *columns: tuple[int, int], side: int = 3, cheap: int = 0) -> CostLattice:
    """Flat ground of 4 J/m with channels that cost half as much beside the line, behind a dear row.

    cheap : columns from the start on along which the line itself costs half as much.
    """
    lattice = ascii_lattice("\n".join(["." * cols] * ROWS))[0]
    traction = np.full((ROWS, cols, 1), 3.0)
    traction[LINE, :cheap] = 1.0
    for first, last in columns:
        traction[LINE + side - 1, first:last] = 6.0
        traction[LINE + side, first:last] = 1.0
    return replace(lattice, traction_per_m=(lattice.traction_per_m + traction).astype(np.float32))


def line(cols: int) -> Points:
    return np.array([(LINE, 2.0), (LINE, cols - 3.0)])


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Length of the paths beside which each ribbon was searched [cells]."""
    lengths = []
    search = beside.ways_beside

    def _search(lattice: CostLattice, vertices: Points, ribbon: Ribbon, *, slack_j: float) -> list:
        lengths.append(float(np.hypot(*(vertices[-1] - vertices[0]))))
        return search(lattice, vertices, ribbon, slack_j=slack_j)

    monkeypatch.setattr(beside, "ways_beside", _search)
    return lengths


def test_a_further_round_looks_only_where_the_path_has_changed(looked: list[float]) -> None:
    lattice, path = channels(160, (100, 150), cheap=90), line(160)
    better = with_ways_beside(lattice, path)
    assert path_price(lattice, better) < 0.95 * path_price(lattice, path)
    ribbons = len(beside.RIBBONS)
    assert looked[:ribbons] == [pytest.approx(155.0)] * ribbons
    assert len(looked) > ribbons
    changed = 160 - 90
    assert all(length < changed + beside.AROUND_CELLS for length in looked[ribbons:])


def test_without_a_gain_there_is_one_round(looked: list[float]) -> None:
    path = line(80)
    np.testing.assert_array_equal(with_ways_beside(channels(80), path), path)
    assert len(looked) == len(beside.RIBBONS)


def test_long_paths_stay_as_they_are(looked: list[float]) -> None:
    cols = int(MOST_CELLS) + 7
    lattice, path = channels(cols, (50, 150)), line(cols)
    assert with_ways_beside(lattice, path) is path
    assert looked == []


def test_what_several_ribbons_find_competes_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lattice, path = channels(80, (20, 60)), line(80)
    settled = []
    compete = beside.competed

    def _compete(lattice, detour, *args):
        settled.append(detour)
        return compete(lattice, detour, *args)

    monkeypatch.setattr(beside, "competed", _compete)
    monkeypatch.setattr(beside, "ROUNDS", 1)
    best = path_price(lattice, with_ways_beside(lattice, path))
    once = len(settled)
    settled.clear()
    monkeypatch.setattr(beside, "SAME_CELLS", 0.0)
    assert path_price(lattice, with_ways_beside(lattice, path)) == pytest.approx(best, rel=1e-4)
    assert 0 < once < len(settled)


def test_nearness_is_of_places_on_legs_and_not_of_vertices() -> None:
    lines = [np.array([(0.0, 0.0), (0.0, 10.0)]), np.array([(5.0, 10.0), (5.0, 0.0)])]
    places = np.array([(0.5, 5.0), (4.5, 5.0), (2.5, 5.0), (0.0, 11.5), (5.2, -0.2), (0.2, 3.0)])
    near = [True, True, False, False, True, True]
    assert near_lines(places, lines, 0.6).tolist() == near
    assert near_lines(places, lines, 0.6, all_or_none=True).tolist() == [True, True, False, False, False, False]
    assert near_lines(subdivided(places[:2], 0.5), lines, 0.6, all_or_none=True).sum() == 1  # not the way between


def test_stretches_are_where_flags_are_set() -> None:
    assert stretches(np.array([True, False, False, True, True])) == [(0, 1), (3, 5)]
    assert stretches(np.zeros(3, dtype=np.bool_)) == []
