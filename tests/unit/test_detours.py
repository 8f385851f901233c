"""Detours: of a path that goes the long way twice, both stretches are replaced, whichever other paths show them."""

import numpy as np
import pytest

from joulemap.planner.detours import best_of
from joulemap.planner.edges import path_price
from tests.reference.lattices import ascii_lattice

ROWS, COLS = 25, 141
WALLS = (35, 105)
HIGH, LOW = 1, 17  # rows of the gaps of each wall


def walls():
    """Two walls, each with a gap at the northern edge and one in the south."""
    rows = [["."] * COLS for _ in range(ROWS)]
    for col in WALLS:
        for row in set(range(ROWS)) - {HIGH, LOW}:
            rows[row][col] = "#"
    return ascii_lattice("\n".join(map("".join, rows)))[0]


def through(first, second):
    """A path over cells through one gap of either wall; between them all such paths are the same for 30 cells."""
    corners = np.array([(12, 5), (first, 34), (first, 36), (12, 55), (12, 85), (second, 104), (second, 106), (12, 135)])
    steps = [np.linspace(a, b, max(abs(b - a)), endpoint=False) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    return np.round(np.vstack([*steps, corners[-1:]]))


def test_both_stretches_are_replaced_though_no_other_path_has_both():
    lattice = walls()
    usual, one, other = through(HIGH, HIGH), through(LOW, HIGH), through(HIGH, LOW)
    alone, some, best = (
        path_price(lattice, best_of(lattice, paths)) for paths in ([usual], [usual, one], [usual, one, other])
    )
    assert best < some < alone
    assert best == pytest.approx(path_price(lattice, best_of(lattice, [through(LOW, LOW)])), rel=1e-3)


def test_a_detour_that_costs_more_is_not_taken():
    lattice = walls()
    short, long = through(LOW, LOW), through(HIGH, LOW)
    np.testing.assert_array_equal(best_of(lattice, [short, long]), best_of(lattice, [short]))
