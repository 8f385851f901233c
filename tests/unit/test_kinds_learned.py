"""Kinds of ground in a calibrated model: partial pooling, and prices on a layer in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.calibration_file import read_calibrated, save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.terrain_class import TerrainClass, TurningByClass
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.terms import Term, turning_per_rad
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers.kinds import Kind
from joulemap.model.terrain.layers.layer import Layer
from joulemap.model.terrain.layers.stack import Layers
from joulemap.service.models import planning_robot
from tests.reference.drives import even

ROBOT = Robot(mass_kg=40.0, idle_power_w=10.0, speed_mps=0.5, rolling_resistance=0.1)
LEVEL = ROBOT.price_per_m(ROBOT.weight_n * 0.1).item()
DRIVEN = {"reference": "grass", "shares": (0.25, 0.15)}
MUD, SAND = 30.0, 70.0
FORM = TerrainClass("terrain", ("mud", "sand"), **DRIVEN)
MEAN = 0.25 * MUD + 0.15 * SAND


def on(*kinds: Kind) -> Heightmap:
    """Level ground of one kind, or of none that is known."""
    frame = GridFrame(0.0, 20.0, 0.5, 40, 40)
    layer = Layer("kinds", "test", frame, np.zeros(frame.shape, dtype=np.int16), kinds)
    return Heightmap(np.zeros(frame.shape, np.float32), frame, layers=Layers((layer,) if kinds else ()))


def model(*more: Term, **options) -> CalibratedPredictor:
    terms = Term(FORM, (MUD, SAND)), *more
    correction = Correction(terms, terms, **options)
    return CalibratedPredictor(PhysicsPredictor(), correction, name="mine", version="1")


def price(found: CalibratedPredictor, ground: Heightmap) -> float:
    one = ROBOT.price_per_m(found.segment_traction(ground, ROBOT, [10.0], [10.0], [0.0]))[0]
    cell = GridFrame(9.5, 10.5, 1.0, 1, 1)
    lattice = ROBOT.price_per_m(found.traction_and_std(ground, ROBOT, cell, heading_bins(4))[0])
    np.testing.assert_allclose(lattice, one, rtol=1e-5)
    return float(one)


@pytest.mark.parametrize(("name", "more"), [("grass", 0.0), ("mud", MUD), ("sand", SAND), ("", MEAN)])
def test_a_kind_costs_what_the_runs_said_whatever_its_default(name, more):
    kinds = (Kind(name, rolling_resistance=0.5),) if name else ()
    assert price(model(), on(*kinds)) == pytest.approx(LEVEL + more, rel=1e-5)


def test_a_kind_that_no_run_had_costs_the_mean_and_how_its_default_differs_from_theirs():
    new = on(Kind("bog", rolling_resistance=0.3))
    mean = 0.6 * 0.06 + 0.25 * 0.22 + 0.15 * 0.2  # of grass, mud and sand in the library
    assert price(model(), new) == pytest.approx(LEVEL + MEAN + ROBOT.weight_n * (0.3 - mean), rel=1e-5)
    assert any("bog" in words for words in model().warnings(new, ROBOT))
    assert any("no layer" in words for words in model().warnings(on(), ROBOT))


def test_what_was_learned_is_in_the_file_of_the_model(tmp_path):
    save_calibrated(tmp_path, model(turn_by_kind={"mud": 3.0}).correction, {"name": "physics", "version": "1"})
    correction, _, _ = read_calibrated(tmp_path)
    assert correction.planner_terms == model().correction.planner_terms
    assert correction.kinds == pytest.approx({"grass": 0.6, "mud": 0.25, "sand": 0.15})
    assert correction.turn_by_kind == {"mud": 3.0}


def test_turning_in_plans_is_that_of_the_kinds_on_the_map():
    crossed = TurningByClass("terrain", ("mud", "sand"), **DRIVEN)
    terms = Term(Turning(), (20.0,)), Term(crossed, (8.0, -4.0))
    rows = replace(even(6), turned_abs_rad=np.linspace(0.0, 1.0, 6), words={"terrain": np.full(6, "sand")})
    assert turning_per_rad(terms, rows) == pytest.approx(20.0 + 0.25 * 8.0 - 0.15 * 4.0)
    assert turning_per_rad(terms, rows, "mud") == pytest.approx(28.0)
    found = model(turn_j_per_rad=21.4, turn_by_kind={"mud": 6.6})
    assert planning_robot(found, ROBOT, on(Kind("mud"))).turn_j_per_rad == pytest.approx(28.0)
    assert planning_robot(found, ROBOT, on()).turn_j_per_rad == pytest.approx(21.4)
