"""Detours: of a path that goes the long way twice, both stretches are replaced, whichever other paths show them."""

import numpy as np
import pytest

from joulemap.planner.best import best_of
from joulemap.planner.edges import path_price
from tests.reference.lattices import ascii_lattice

ROWS, COLS = 25, 141
HIGH, MIDDLE, LOW = 1, 9, 18  # rows of gaps
GAPS = {35: (HIGH, LOW), 56: (MIDDLE,), 84: (MIDDLE,), 105: (HIGH, LOW)}  # of the wall in each of these columns


def walls():
    """Four walls: every path goes through the gaps of the two in the middle, and one of two gaps of the others."""
    rows = [["."] * COLS for _ in range(ROWS)]
    for col, gaps in GAPS.items():
        for row in set(range(ROWS)) - set(gaps):
            rows[row][col] = "#"
    return ascii_lattice("\n".join(map("".join, rows)))[0]


def through(first, second):
    """A path over cells through one gap of the first wall and of the last."""
    gaps = [(first, 34), (first, 36), (MIDDLE, 55), (MIDDLE, 85), (second, 104), (second, 106)]
    corners = np.array([(MIDDLE, 5), *gaps, (MIDDLE, 135)])
    steps = [np.linspace(a, b, max(abs(b - a)), endpoint=False) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    return np.round(np.vstack([*steps, corners[-1:]]))


def test_both_stretches_are_replaced_though_no_other_path_has_both():
    lattice = walls()
    usual, one, other = through(LOW, LOW), through(HIGH, LOW), through(LOW, HIGH)
    alone, some, best = (
        path_price(lattice, best_of(lattice, paths)) for paths in ([usual], [usual, one], [usual, one, other])
    )
    assert best < some < alone
    assert best == pytest.approx(path_price(lattice, best_of(lattice, [through(HIGH, HIGH)])), rel=1e-3)


def test_a_detour_that_costs_more_is_not_taken():
    lattice = walls()
    short, long = through(HIGH, HIGH), through(LOW, HIGH)
    np.testing.assert_array_equal(best_of(lattice, [short, long]), best_of(lattice, [short]))
