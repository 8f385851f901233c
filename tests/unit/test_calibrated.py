"""A calibrated model plans with its effects: prices of lattices and segments are those its formulas state."""

import inspect
import math
import re

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import USUAL_SPREAD, Spread
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.loop.calibrated import CalibratedPredictor, Correction
from joulemap.model.loop.effects import Term
from joulemap.model.loop.formulas import FORMULAS, GROUND
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.report import where_words
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

ROBOT = Robot(mass_kg=40.0, idle_power_w=10.0, speed_mps=0.5, rolling_resistance=0.1)
WEIGHT = ROBOT.weight_n


def hill(slope=0.05):
    frame = GridFrame(0.0, 30.0, 0.5, 60, 80, None)
    x, _ = frame.centres()
    return Heightmap(np.tile(slope * x, (60, 1)).astype(np.float32), frame)


def calibrated(*terms, **options):
    correction = Correction(tuple(terms), (True,) * len(terms), **options)
    return CalibratedPredictor(PhysicsPredictor(), correction, name="mine", version="1")


EFFECTS = {  # what each adds to a metre up the hill of grade 0.05, along its heading [J/m]
    "friction": (Term("rolling_resistance", "friction", ("",), coefficients=(0.03,)), 0.03 * WEIGHT),
    "hotel": (Term("hotel_load", "hotel_load", ("W",), coefficients=(5.0,)), 10.0),
    "gain": (Term("sensor_gain", "sensor_gain", ("",), coefficients=(0.1,)), 0.1 * (20.0 + 0.15 * WEIGHT)),
    "turning": (Term("turning", "turning", ("J/rad",), {"limit_radps": None}, {}, (50.0,)), 0.0),
    "east wind": (Term("wind", "wind_constant", ("J/m", "J/m"), coefficients=(7.0, 3.0)), 7.0),
    "only uphill": (
        Term("rolling_resistance", "friction", ("",), {}, {"over": "grade", "above": 0.02}, (0.03,)),
        0.03 * WEIGHT,
    ),
    "only downhill": (
        Term("rolling_resistance", "friction", ("",), {}, {"over": "grade", "below": -0.02}, (0.03,)),
        0.0,
    ),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_the_price_of_a_metre_uphill_is_base_and_effect(name):
    term, extra = EFFECTS[name]
    east = math.pi / 2
    traction = calibrated(term).segment_traction(hill(), ROBOT, [20.0], [15.0], [east])
    base = 20.0 + 0.15 * WEIGHT
    assert ROBOT.price_per_m(traction)[0] == pytest.approx(base + extra, rel=1e-5)


def test_a_lattice_entry_is_the_answer_for_that_segment():
    source = calibrated(*(term for term, _ in EFFECTS.values()))
    ground = hill()
    frame = ground.frame.respaced(1.0)
    headings = heading_bins(8)
    lattice = source.traction_per_m(ground, ROBOT, frame, headings)
    x, y = frame.centres()
    for row, col, k in ((5, 7, 0), (20, 30, 3), (12, 25, 6)):
        one = source.segment_traction(ground, ROBOT, [x[col]], [y[row]], [headings[k]])
        assert lattice[row, col, k] == pytest.approx(one[0], rel=1e-5)


def test_what_was_learned_of_heights_stays_near_them():
    """Grass below 2 m on a hill that was driven from 1 to 3 m: known from 0.5 to 3.5 m, and nowhere lower or higher."""
    knots = {"over": "elevation", "knots": [1.0, 2.0, 3.0], "of": "length"}
    grass = Term("learned:elevation", "smooth", ("J/m", "J/m"), knots, {}, (40.0, 0.0))
    source, base = calibrated(grass), calibrated()
    x = np.array([4.0, 6.0, 10.0, 15.0, 36.0])  # heights 0.4, 0.6, 1.0, 1.5 and 3.6 m
    extra = [ROBOT.price_per_m(m.segment_traction(hill(0.1), ROBOT, x, 15.0, math.pi / 2)) for m in (source, base)]
    np.testing.assert_allclose(extra[0] - extra[1], [0.0, 40.0, 40.0, 20.0, 0.0], atol=1e-4)
    assert where_words(grass) == "at heights about those driven, 0.5 to 3.5 m; nothing at others"
    assert source.warnings(hill(0.0), ROBOT)[-1].endswith(
        "it adds nothing on the 100% of this map that lies at other heights"
    )
    near = Heightmap(hill().heights + 1.0, hill().frame)  # from 1 to 3 m
    assert source.warnings(near, ROBOT) == base.warnings(near, ROBOT)


def test_turns_go_into_the_robot():
    source = calibrated(EFFECTS["turning"][0], turn_j_per_rad=50.0)
    assert source.robot_with_turning(ROBOT).turn_j_per_rad == 50.0
    assert source.robot_with_turning(ROBOT).mass_kg == ROBOT.mass_kg


def test_charge_is_planned_at_the_nominal_voltage():
    plane = Term("level", "plane", ("A s/m", "1/V", "1/V"), coefficients=(3.0, 0.05, 0.02))
    source, base = calibrated(plane, charge=True), calibrated()
    for heading in (0.0, math.pi):
        t = base.segment_traction(hill(), ROBOT, [20.0], [15.0], [heading])[0]
        ampere_seconds = 3.0 + 0.05 * max(t, 0.0) + 0.02 * min(t, 0.0)
        price = ROBOT.price_per_m(source.segment_traction(hill(), ROBOT, [20.0], [15.0], [heading]))[0]
        assert price == pytest.approx(max(ROBOT.nominal_voltage_v * ampere_seconds, ROBOT.hotel_per_m))


def test_the_deviation_is_that_of_what_remained():
    """Of a model without a word of its own: a tenth of the price, times the factor of the held-out runs."""
    source = calibrated(spread=Spread(factor=1.5, run_share=0.02))
    east = math.pi / 2
    _, std = source.segment_traction_and_std(hill(), ROBOT, [20.0], [15.0], [east])
    assert std[0] == pytest.approx(1.5 * USUAL_SPREAD * (20.0 + 0.15 * WEIGHT), rel=1e-5)
    frame = hill().frame.respaced(1.0)
    lattice = source.traction_and_std(hill(), ROBOT, frame, heading_bins(4))[1]
    assert lattice[15, 20, 1] == pytest.approx(std[0], rel=1e-5)
    assert source.provenance()["spread"]["run_share"] == source.spread.run_share == 0.02
    assert Correction.from_dict(source.correction.as_dict()).spread == source.spread
    assert calibrated().traction_and_std(hill(), ROBOT, frame, heading_bins(4))[1] is None


def test_who_reads_the_ground_says_so():
    """Of every formula and quantity: those whose code reads the ground of a drive are listed, and no others."""
    fields = ("grade", "along", "cross_abs", "cross_sq", "cross", "roughness_m", "elevation_m", "hollow_m")
    for name, formula in FORMULAS.items():
        reads = any(f"drive.{field}" in inspect.getsource(formula) for field in fields)
        assert reads == (name in GROUND), name
    known = re.findall(r'"(\w+)": lambda: drive\.(\w+)', inspect.getsource(quantity))
    assert {name for name, field in known if field in fields} == GROUND - {"braking", "climbing"}
    for name, field in known:
        assert Term("x", "smooth", ("",), {"over": name, "knots": [0.0], "of_all": False}).reads_ground == (
            field in fields
        )
    assert Term("x", "by_run", ("",), {"of": "climbing", "runs": []}).reads_ground
    assert Term("x", "friction", ("",), {}, {"over": "roughness", "above": 0.01}).reads_ground
    assert not Term("x", "friction", ("",), {}, {"word": "terrain", "is": "mud"}).reads_ground
