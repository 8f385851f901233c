"""Paths that lost compete once more where they differ from the best one."""

import numpy as np
import pytest

from joulemap.planner import rivals
from joulemap.planner.edges import path_price
from joulemap.planner.rivals import DISTANCE_CELLS, with_rivals
from joulemap.planner.shaken import AROUND_CELLS
from tests.reference.lattices import uniform_lattice


def field():
    """Flat ground of 4 J/m with a channel that costs half as much, ten rows beside the line."""
    lattice = uniform_lattice(31, 60, lambda heading: 4.0)
    lattice.traction_per_m[4:7] = 2.0
    return lattice, np.array([(15.0, 5.0), (15.0, 55.0)])


def test_a_rival_that_is_cheaper_somewhere_is_taken_there():
    lattice, path = field()
    rival = np.array([(15.0, 5.0), (5.0, 15.0), (5.0, 45.0), (15.0, 55.0)])
    better = with_rivals(lattice, path, [path, rival])
    assert path_price(lattice, better) <= path_price(lattice, rival) < path_price(lattice, path)
    np.testing.assert_array_equal(better[[0, -1]], path[[0, -1]])
    np.testing.assert_array_equal(better, with_rivals(lattice, path, [path, rival]))


def test_only_stretches_that_differ_are_shaken(monkeypatch):
    lattice, path = field()
    rival = np.array([(15.0, 5.0), (15.0, 25.0), (12.0, 30.0), (15.0, 35.0), (15.0, 55.0)])
    looked = []
    monkeypatch.setattr(rivals, "with_stretches", lambda _, points, stretches, __: looked.append(stretches) or points)
    assert with_rivals(lattice, path, [path, rival]) is path
    ((stretch,),) = looked
    assert np.abs(stretch - [15.0, 30.0]).max(axis=0) == pytest.approx([3.0, 5.0 + AROUND_CELLS], abs=2.5)
    beside = path + np.array([0.5 * DISTANCE_CELLS, 0.0])
    assert with_rivals(lattice, path, [beside]) is path
    assert looked[1:] == [[]]
