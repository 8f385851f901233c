"""A calibrated model plans with its effects, within the ranges of its runs: prices are those that the forms state."""

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import USUAL_SPREAD, Spread
from joulemap.model.errors import ConflictError, ModelError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.calibration_file import read_calibrated, save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms._base_parameters import BaseParameters
from joulemap.model.loop.forms.baseline_change import HotelLoad, RollingResistance, SensorGain
from joulemap.model.loop.forms.climbing import Climbing
from joulemap.model.loop.forms.drift import Drift
from joulemap.model.loop.forms.log_faults import MeterLag
from joulemap.model.loop.forms.simple_costs import SimpleCosts
from joulemap.model.loop.forms.speed import Speed
from joulemap.model.loop.forms.structure import Curve
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.terms import Term
from joulemap.model.robot import Robot
from joulemap.model.runs.features import Drives
from joulemap.model.terrain.heightmap import Heightmap
from tests.reference.drives import even

ROBOT = Robot(mass_kg=40.0, idle_power_w=10.0, speed_mps=0.5, rolling_resistance=0.1)
WEIGHT = ROBOT.weight_n
BASE = 20.0 + 0.15 * WEIGHT  # J, a metre up a hill of 0.05 at 0.5 m/s
EAST = math.pi / 2


def hill(slope=0.05):
    frame = GridFrame(0.0, 30.0, 0.5, 60, 80, None)
    x, _ = frame.centres()
    return Heightmap(np.tile(slope * x, (60, 1)).astype(np.float32), frame)


def calibrated(*terms, logged=(), **options):
    """Of effects that plans contain, and of some that only a log shows."""
    correction = Correction((*terms, *logged), tuple(terms), **options)
    return CalibratedPredictor(PhysicsPredictor(), correction, name="mine", version="1")


def price(model, robot=ROBOT, *, ground=None, heading=EAST):
    return robot.price_per_m(model.segment_traction(ground or hill(), robot, [20.0], [15.0], [heading]))[0]


EFFECTS = {  # what each adds to a metre up the hill of grade 0.05, along its heading [J/m]
    "rolling resistance": (Term(RollingResistance(), (0.03,)), 0.03 * WEIGHT),
    "idle power": (Term(HotelLoad(), (5.0,)), 10.0),
    "gain": (Term(SensorGain(), (0.1,)), 0.1 * BASE),
    "turning": (Term(Turning(), (50.0,)), 0.0),
    "heading": (Term(Curve("heading", (0.0, EAST, math.pi, 3.0 * EAST)), (0.0, 7.0, -3.0)), 7.0),
    "climbing": (Term(Climbing(), (0.2,)), 0.2 * 0.05 * WEIGHT),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_the_price_of_a_metre_uphill_is_base_and_effect(name):
    term, extra = EFFECTS[name]
    assert price(calibrated(term)) == pytest.approx(BASE + extra, rel=1e-5)
    assert price(calibrated(logged=[term])) == pytest.approx(BASE, rel=1e-5)  # what plans do not contain


SIMPLE = Term(
    SimpleCosts(("length", "climb", "turned", "time")), (30.0, 400.0, 70.0, 6.0)
)  # J/m, J per metre of climb, J/rad, W


SIMPLE_PRICE = 30.0 + 400.0 * 0.05 + 6.0 / 0.5


def test_least_squares_that_predict_better_are_all_of_a_price(tmp_path):
    correction = Correction((), (SIMPLE,), alone=True, planner_scale=1.1, scale=1.3)
    folder = tmp_path / "model"
    version = save_calibrated(folder, correction, {"name": "physics", "version": "1"})
    read, _, again = read_calibrated(folder)
    assert (read.planner_terms, read.alone, read.planner_scale, read.scale, again) == (
        (SIMPLE,),
        True,
        1.1,
        1.3,
        version,
    )
    model = CalibratedPredictor(PhysicsPredictor(), read, name="mine", version=version)
    assert price(model) == pytest.approx(1.1 * SIMPLE_PRICE, rel=1e-5)
    assert model.correction.only_in_logs == []


def test_where_the_model_before_is_better_plans_use_it():
    """As declared, whatever the calibration found."""
    model = calibrated(logged=[EFFECTS["climbing"][0]], alone=True, drives=Drives(coasting_shift=0.01))
    assert price(model) == pytest.approx(BASE, rel=1e-5)


def test_of_slopes_that_no_run_has_shown_the_base_model_knows_the_price():
    level = BaseParameters(("rolling_resistance", "idle_power_w"))
    first = Term(level, (0.0, 0.0))
    model = calibrated(SIMPLE, alone=True, first_base=first)
    assert price(model) == pytest.approx(30.0 + 6.0 / 0.5 + 0.05 * WEIGHT, rel=1e-5)


def test_plans_pay_for_the_turns_of_the_base_model_too():
    class Turns(PhysicsPredictor):
        def robot_with_turning(self, robot):
            return replace(robot, turn_j_per_rad=robot.turn_j_per_rad + 300.0)

    model = CalibratedPredictor(Turns(), Correction((), (), turn_j_per_rad=280.0), name="mine", version="1")
    assert model.robot_with_turning(replace(ROBOT, turn_j_per_rad=5.0)).turn_j_per_rad == 585.0


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


RANGES = {"speed": (0.2, 0.6), "grade": (-0.08, 0.08), "cross_slope": (0.0, 0.1)}


@pytest.mark.parametrize("slope", [60.0, -12.0])
def test_beyond_the_speeds_driven_the_value_at_the_border_holds(slope):
    """So much for each m/s: at 1.0 m/s what it is at 0.6 m/s."""
    source = calibrated(Term(Speed(), (slope,)), ranges=RANGES)
    fast = Robot(mass_kg=40.0, idle_power_w=10.0, speed_mps=1.0, rolling_resistance=0.1)
    border, base = 0.6 * slope, 10.0 + 0.15 * WEIGHT  # 10 W for 1 s
    assert price(source, fast) == pytest.approx(base + border, rel=1e-5)
    unlimited = calibrated(Term(Speed(), (slope,)))
    assert price(unlimited, fast) == pytest.approx(base + slope, rel=1e-5)
    (words,) = source.warnings(hill(), fast)
    assert words.startswith("the robot's speed of 1 m/s is outside the 0.2 m/s to 0.6 m/s of the calibration runs")
    assert source.warnings(hill(), ROBOT) == []


def test_beyond_the_grades_driven_the_value_at_the_border_holds():
    """40 J/m more at a grade of 0.08 than at level, by a straight line; on a hill of 0.1 what it is at 0.08."""
    curve = Term(Curve("grade", (-0.2, 0.0, 0.2)), (0.0, 100.0))
    source, ground = calibrated(curve, ranges=RANGES), hill(0.1)
    assert price(source, ground=ground) == pytest.approx(20.0 + 0.2 * WEIGHT + 40.0, rel=1e-4)
    (words,) = source.warnings(ground, ROBOT)
    assert "of this map has a grade outside the -0.08 to 0.08 of the calibration runs" in words
    assert words.startswith("50%")  # east and west of four headings
    assert calibrated(curve).warnings(ground, ROBOT) == []


def test_plans_say_which_effects_they_lack_but_not_which_faults_the_log_had():
    source = calibrated(logged=[Term(Drift("clock"), (0.1,)), Term(MeterLag(), (0.7,))])
    (words,) = source.warnings(hill(), ROBOT)
    assert words.startswith("plans do not contain the effect drift over time or distance")


def test_what_lies_beyond_is_a_share_of_the_rows():
    correction = Correction((), (), ranges={"speed": (0.2, 0.6), "roughness": (0.0, 0.01)})
    rows = even(4, duration_s=[2.0, 2.0, 1.0, 10.0], roughness_m=[0.0, 0.02, 0.0, 0.0])  # 0.5, 0.5, 1.0, 0.1 m/s
    assert correction.beyond(rows) == {"speed": 0.5}  # nothing depends on the roughness


def test_turns_go_into_the_robot():
    source = calibrated(EFFECTS["turning"][0], turn_j_per_rad=50.0)
    assert source.robot_with_turning(ROBOT).turn_j_per_rad == 50.0
    assert source.robot_with_turning(ROBOT).mass_kg == ROBOT.mass_kg
    assert calibrated(turn_j_per_rad=-50.0).robot_with_turning(ROBOT).turn_j_per_rad == 0.0  # nothing for nothing


def test_charge_is_planned_at_the_nominal_voltage():
    plane = Term(BaseParameters(("per_metre", "standing_current")), (3.0, 1.5))
    ampere_seconds = 3.0 + 1.5 * 2.0  # a metre takes 2 s
    assert price(calibrated(plane, charge=True)) == pytest.approx(ROBOT.nominal_voltage_v * ampere_seconds, rel=1e-5)


def test_the_deviation_is_that_of_what_remained():
    """Of a model without a word of its own: a tenth of the price, times the factor of the left-out runs."""
    source = calibrated(spread=Spread(factor=1.5, run_share=0.02))
    _, std = source.segment_traction_and_std(hill(), ROBOT, [20.0], [15.0], [EAST])
    assert std[0] == pytest.approx(1.5 * USUAL_SPREAD * BASE, rel=1e-5)
    frame = hill().frame.respaced(1.0)
    lattice = source.traction_and_std(hill(), ROBOT, frame, heading_bins(4))[1]
    assert lattice[15, 20, 1] == pytest.approx(std[0], rel=1e-5)
    assert source.provenance()["spread"]["run_share"] == source.spread.run_share == 0.02
    assert calibrated().traction_and_std(hill(), ROBOT, frame, heading_bins(4))[1] is None


WHOLE = Correction(
    (*(term for term, _ in EFFECTS.values()), Term(BaseParameters(("idle_power_w",)), (1.0,))),
    (EFFECTS["turning"][0],),
    ranges=RANGES,
    turn_j_per_rad=50.0,
    conditions={"temperature": 12.0},
    evidence=[{"name": "turning", "p_value": 1e-6, "share": 0.4}],
    spread=Spread(factor=1.5, run_share=0.02),
)


def test_a_calibration_is_kept_whole_and_never_changed(tmp_path):
    version = save_calibrated(tmp_path, WHOLE, {"name": "physics", "version": "1"})
    assert read_calibrated(tmp_path) == (WHOLE, {"name": "physics", "version": "1"}, version)
    with pytest.raises(ConflictError, match="never changed"):
        save_calibrated(tmp_path, WHOLE, {"name": "physics", "version": "1"})
    file = tmp_path / "calibration.json"
    file.write_text(file.read_text().replace("50.0", "51.0"))
    with pytest.raises(ModelError, match="is not the calibration"):
        read_calibrated(tmp_path)


def test_a_calibration_of_an_older_version_must_be_made_again(tmp_path):
    save_calibrated(tmp_path, WHOLE, {"name": "physics", "version": "1"})
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"format": 1}))
    with pytest.raises(ModelError, match="has format 1, and this version of joulemap reads format 3: calibrate"):
        read_calibrated(tmp_path)


@pytest.mark.parametrize(
    ("changed", "missing"),
    [({"drives": None}, "TypeError"), ({"terms": [{"form": "turning", "name": "turning"}]}, "KeyError..coefficients")],
)
def test_a_calibration_that_lacks_something_is_refused(tmp_path, changed, missing):
    save_calibrated(tmp_path, WHOLE, {"name": "physics", "version": "1"})
    file = tmp_path / "calibration.json"
    content = {key: value for key, value in json.loads(file.read_text()).items() if key != "version"} | changed
    version = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    file.write_text(json.dumps({"version": version, **content}))
    with pytest.raises(ModelError, match=f"a calibration is not complete: {missing}"):
        read_calibrated(tmp_path)


def test_plans_say_the_means_of_the_runs_at_which_they_are_made():
    model = calibrated(EFFECTS["heading"][0], conditions={"payload": 55.4, "temperature": 12.0, "wind_speed": 0.0})
    assert "plans are made at the means of the calibration runs: payload 55.4 kg" in model.warnings(hill(), ROBOT)
    assert not calibrated(EFFECTS["heading"][0], conditions={"payload": 0.0}).warnings(hill(), ROBOT)
