"""Forms of effects: their columns against numbers worked out by hand, their settings in files, and their words."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import ModelError
from joulemap.model.loop._design import linearised
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms import CHANGES, FORMS, NAMED, UNNAMED, form_from_dict
from joulemap.model.loop.forms._base_parameters import BaseParameters
from joulemap.model.loop.forms.auxiliary_power import AuxiliaryPower
from joulemap.model.loop.forms.baseline_change import (
    Acceleration,
    Braking,
    HotelLoad,
    Mass,
    RollingResistance,
    SensorGain,
)
from joulemap.model.loop.forms.change import Change
from joulemap.model.loop.forms.climbing import Climbing
from joulemap.model.loop.forms.copper_loss import CopperLoss
from joulemap.model.loop.forms.cross_slope import CrossSlope
from joulemap.model.loop.forms.drift import Drift
from joulemap.model.loop.forms.log_faults import MapShift, MeterLag
from joulemap.model.loop.forms.payload import Payload
from joulemap.model.loop.forms.power_limit import PowerLimit
from joulemap.model.loop.forms.reversing import Reversing
from joulemap.model.loop.forms.roughness import Roughness
from joulemap.model.loop.forms.speed import Speed
from joulemap.model.loop.forms.structure import Curve, PlaceField
from joulemap.model.loop.forms.temperature import Temperature
from joulemap.model.loop.forms.terrain_class import TerrainClass, TurningByClass
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.forms.warming_up import WarmingUp
from joulemap.model.loop.forms.wind import Wind
from joulemap.model.loop.terms import Term, turning_per_rad
from joulemap.model.runs.features import Drives, driven_ranges
from tests.reference.drives import ROBOT, even, made_up
from tests.reference.words import PRIVATE

W = 40.0 * 9.80665  # N, of 40 kg
MOTION = 0.08 * W  # J, a metre on level ground with a rolling resistance of 0.08
PREDICTED = MOTION + 2.0 * 12.0  # J, with 12 W for 2 s
UP = {"grade": [0.1], "grades": [[0.1] * 5], "traction_per_m": [0.18 * W]}
DOWN = {"grade": [-0.2], "grades": [[-0.2] * 5], "traction_per_m": [-0.12 * W]}  # steeper than it rolls: nothing pulls


def breeze(source_deg):
    return even(columns={"wind_speed": np.array([2.0]), "wind_from": np.array([source_deg])})


def on(word):
    return even(words={"terrain": np.array([word])}, turned_abs_rad=[0.5])


MUD = {"words": {"terrain": np.array(["mud"])}, "turned_abs_rad": [0.5]}


def of_motors(**more):
    """A metre at half the speed at which a motor takes what a battery gives: the same torque for twice the time."""
    return even(drives=Drives(motor_speed_mps=1.0), **more)


BY_HAND = {  # (form, one metre, what one unit of each coefficient adds to it [J])
    "turning": (Turning(), even(turned_abs_rad=[0.7]), [0.7]),
    "turning up to a curvature": (Turning(limit_per_m=0.6), even(turned_abs_rad=[0.7]), [0.6]),
    "turning of motors": (Turning(), of_motors(turned_abs_rad=[0.7]), [2.0 * 0.7]),
    "turning of motors by class": (TurningByClass("terrain", ("mud",), 0.3), of_motors(**MUD), [2.0 * 0.3]),
    "class for motors": (TerrainClass("terrain", ("mud",)), of_motors(**MUD), [2.0]),
    "rolling resistance of motors": (RollingResistance(), of_motors(), [2.0 * W]),
    "speed": (Speed(1), even(duration_s=[1.25]), [0.8]),  # 0.8 m/s
    "speed squared": (Speed(2), even(duration_s=[1.25]), [0.64]),
    "cross slope": (CrossSlope(1), even(cross_abs=[0.1]), [0.1 * W]),
    "cross slope squared": (CrossSlope(2), even(cross_sq=[0.02]), [0.02 * W]),
    "cross slope where nothing pulls": (CrossSlope(1), even(cross_abs=[0.1], **DOWN), [0.0]),
    "roughness": (Roughness(), even(roughness_m=[0.02]), [0.02 * W]),
    "reversing": (Reversing(), even(columns={"heading": np.array([180.0])}), [1.0]),
    "no reversing": (Reversing(), even(columns={"heading": np.array([10.0])}), [0.0]),
    "climbing": (Climbing(False), even(**UP), [0.1 * W]),
    "no climbing": (Climbing(False), even(**DOWN), [0.0]),
    "slip": (Climbing(True), even(**UP), [0.1 * 0.18 * W]),
    "battery": (CopperLoss(False), even(), [(PREDICTED / 2.0 / ROBOT.nominal_voltage_v) ** 2 * 2.0]),
    "copper loss": (CopperLoss(True), even(), [0.08**2 * 2.0]),
    "power limit": (PowerLimit(20.0), even(), [PREDICTED - 20.0 * 2.0]),
    "below the power limit": (PowerLimit(100.0), even(), [0.0]),
    "auxiliary power": (AuxiliaryPower("arm [kW]", 1e3), even(columns={"arm [kW]": np.array([0.3])}), [600.0]),
    "heater": (Temperature(10.0, "time"), even(columns={"temperature": np.array([15.0])}), [2.0 * 5.0]),
    "grease": (Temperature(10.0, "motion"), even(columns={"temperature": np.array([5.0])}), [-5.0 * MOTION]),
    "grease as viscous as oil": (
        Temperature(10.0, "length", 0.05),
        even(columns={"temperature": np.array([-10.0])}),
        [-math.e / 0.05],
    ),
    "temperature unknown": (Temperature(10.0, "time"), even(columns={"temperature": np.array([np.nan])}), [0.0]),
    "payload": (Payload(), even(columns={"payload": np.array([3.0])}), [3.0 / 40.0 * MOTION]),
    "wind from ahead": (Wind("air"), breeze(0.0), [2.5**2 - 0.5**2]),
    "wind from behind": (Wind("air"), breeze(180.0), [-(1.5**2) - 0.5**2]),
    "wind across": (Wind("air"), breeze(90.0), [0.5 * math.hypot(0.5, 2.0) - 0.5**2]),
    "head wind": (Wind("head"), breeze(60.0), [1.5**2 - 0.5**2]),
    "wind in proportion": (Wind("linear"), breeze(60.0), [2.0 * 0.5]),
    "drift per hour": (Drift("since_start"), even(since_s=[1800.0]), [0.5 * PREDICTED]),
    "before a change": (Change(100.0, 3), even(clock_s=[99.0]), [0.0]),
    "after a change": (Change(100.0, 3), even(clock_s=[100.0]), [PREDICTED]),
    "warming up": (WarmingUp(600.0), even(since_s=[1200.0]), [math.exp(-2.0)]),
    "drift per kilometre": (Drift("driven", of_all=False), even(driven_m=[250.0]), [0.25]),
    "class": (TerrainClass("terrain", ("mud", "sand")), on("sand"), [0.0, 1.0]),
    "class of motion": (TerrainClass("terrain", ("mud", "sand"), True), on("mud"), [MOTION, 0.0]),
    "reference class": (TerrainClass("terrain", ("mud", "sand")), on("grass"), [0.0, 0.0]),
    "turning by class": (TurningByClass("terrain", ("mud", "sand")), on("mud"), [0.5, 0.0]),
    "map shift": (MapShift(), even(grade_east=[0.01], grade_north=[-0.02]), [0.01 * W, -0.02 * W]),
    "hotel load": (HotelLoad(), even(), [2.0]),
    "rolling resistance": (RollingResistance(), even(), [W]),
    "mass": (Mass(), even(**UP), [0.18 * W]),
    "acceleration": (Acceleration(), even(gained_m2ps2=[0.125]), [0.125]),  # from 0 to 0.5 m/s
    "braking": (Braking(0.08), even(**DOWN), [0.12 * W]),
    "sensor gain": (SensorGain(), even(), [PREDICTED]),
    "curve per metre": (Curve("roughness", (0.0, 0.01, 0.03), "length"), even(roughness_m=[0.02]), [0.0, 0.5]),
    "curve against baseline runs": (
        Curve("roughness", (0.0, 0.01, 0.03), "length", centred=False),
        even(roughness_m=[0.02]),
        [0.0, 0.5, 0.5],
    ),
    "curve beyond its end": (Curve("roughness", (0.0, 0.01, 0.03), "length"), even(roughness_m=[0.3]), [0.0, 1.0]),
    "curve per second": (
        Curve("column:rain", (0.0, 1.0, 2.0), "time"),
        even(columns={"rain": np.array([0.25])}),
        [0.75 * 2.0, 0.0],
    ),
    "curve unknown": (Curve("column:rain", (0.0, 1.0, 2.0)), even(columns={"rain": np.array([np.nan])}), [0.0, 0.0]),
    "curve over the heading": (
        Curve("heading", (0.0, math.pi / 2, math.pi, 1.5 * math.pi)),
        even(heading_rad=[1.75 * math.pi]),  # north-west, between west and north
        [0.5, 0.0, 0.5],
    ),
    "place": (
        PlaceField(((3.0, 4.5), (0.0, 0.5)), 5.0),
        even(),  # at 0.0, 0.5: one width from the first centre, upon the second
        [W * math.exp(-0.5), W],
    ),
}


@pytest.mark.parametrize("case", BY_HAND)
def test_a_column_is_what_the_formula_says(case):
    form, rows, expected = BY_HAND[case]
    np.testing.assert_allclose(form.columns(rows), [expected], rtol=1e-9, atol=1e-12)
    assert len(form.coefficient_names()) == len(form.units("J")) == len(expected)
    value = sum((k + 2.0) * e for k, e in enumerate(expected))
    term = Term(form, tuple(k + 2.0 for k in range(len(expected))))
    assert term.energy(rows)[0] == pytest.approx(value)


@pytest.mark.parametrize("case", BY_HAND)
def test_a_form_comes_back_from_its_file(case):
    form = BY_HAND[case][0]
    assert form_from_dict(json.loads(json.dumps(form.as_dict(), allow_nan=False))) == form


def test_a_direction_has_no_range():
    """Runs with winds from 10 to 40 degrees say nothing against a wind from 350 degrees, which is near."""
    rows = even(
        4, columns={"wind_from": np.array([10.0, 20.0, 30.0, 40.0]), "wind_speed": np.array([1.0, 2.0, 3.0, 4.0])}
    )
    ranges = driven_ranges(rows)
    assert "column:wind_from" not in ranges
    other = even(columns={"wind_from": np.array([350.0]), "wind_speed": np.array([9.0])}).within(ranges)
    assert other.columns["wind_from"] == [350.0]
    assert other.columns["wind_speed"] == pytest.approx([3.97])


def test_a_power_is_known_by_its_name():
    columns = (
        "Heating Power [kW]",
        "computer_w",
        "auxiliary power",
        "lidar_power_mW",
        "temperature",
        "Heater Current [A]",
    )
    rows = even(columns={name: np.array([1.0]) for name in columns})
    found = {form.logged: form.watts for form in AuxiliaryPower.variants(rows)}
    assert found == {"Heating Power [kW]": 1e3, "computer_w": 1.0, "auxiliary power": 1.0, "lidar_power_mW": 1e-3}
    assert not any(form.over.removeprefix("column:") in found for form in Curve.variants(rows))


def test_every_form_is_worked_out_by_hand():
    assert {type(form) for form, _, _ in BY_HAND.values()} | {MeterLag} == {*NAMED, *CHANGES, *UNNAMED}


def test_of_readings_that_are_late_power_at_both_ends_counts():
    """Power that rises by 10 W from row to row: a second late, every row is read with 10 J less."""
    rows = even(30, traction_per_m=(30.0 + 10.0 * np.arange(30) - 12.0) * 2.0)
    late = MeterLag().column(rows)
    np.testing.assert_allclose(late[10:-10], -10.0, rtol=1e-4)
    np.testing.assert_allclose(late[[0, -1]], -5.0, rtol=0.2)  # before and after the run it goes on level
    assert not MeterLag.on_map


def test_a_calibrated_late_meter_reads_all_that_is_drawn_late():
    """Waves of 4 rows, a quarter of a wave late: far from a straight line in the lag."""
    rows = even(40, turned_abs_rad=1.0 + np.sin(0.5 * math.pi * np.arange(40)))
    base = BaseParameters.of(charge=False)
    nothing = Term(base, (0.0,) * len(base.names))
    turning, late = Term(Turning(), (30.0,)), Term(MeterLag(), (2.0,))
    added = Correction((nothing, turning, late), (), first_base=nothing).added_energy(rows, planned=False)
    earlier = rows.predicted + 30.0 * (1.0 + np.sin(0.5 * math.pi * (np.arange(40) - 1.0)))  # by one row of 2 s
    np.testing.assert_allclose((rows.predicted + added)[1:], earlier[1:])


@pytest.mark.parametrize(("fault", "size"), [(MeterLag(), [0.8]), (MapShift(), [0.7, 0.3])])
def test_a_fault_about_its_size_is_what_was_simulated(fault, size):
    """The columns times the size and the rest are that; and a little more of the fault is a little more of a column."""
    rng = np.random.default_rng(1)
    slope = 0.01 * rng.standard_normal((2, 40))
    rows = even(40, turned_abs_rad=rng.uniform(0.0, 1.0, 40), grade_east=slope[0], grade_north=slope[1])

    def energy(of):
        return of.predicted + 30.0 * of.turned_abs_rad

    size = np.array(size)
    columns, beyond = linearised(fault, rows, size, energy)
    np.testing.assert_allclose(columns @ size + beyond, fault.simulated(rows, size, energy), atol=1e-9)
    there = fault.simulated(rows, size + 1e-3, energy)
    np.testing.assert_allclose(columns @ (size + 1e-3) + beyond, there, atol=1e-3 * np.abs(there).max())
    assert np.abs(columns).max() > 1.0


def test_a_moved_map_has_other_slopes():
    rows = even(grade_east=[0.01], grade_north=[-0.02]).moved(2.0, 1.0)
    assert rows.grade == pytest.approx([0.0])
    assert even(grade_east=[0.01]).moved(2.0, 0.0).base_motion - even().base_motion == pytest.approx([0.02 * W])


LOADS = {"payload": (5.0, 20.0), "wind_speed": (1.0, 4.0), "temperature": (0.0, 10.0)}


@pytest.mark.parametrize(
    ("form", "logged", "holds"),
    [
        (Payload(), {"payload": 30.0}, True),
        (Wind("head"), {"wind_speed": 6.0, "wind_from": 0.0}, True),
        (Temperature(5.0, "length", 0.06), {"temperature": -10.0}, False),
        (Temperature(5.0, "length"), {"temperature": -10.0}, False),
    ],
)
def test_a_law_holds_beyond_the_runs_and_what_was_fitted_does_not(form, logged, holds):
    rows = even(columns={key: np.array([value]) for key, value in logged.items()})
    ranges = {f"column:{key}": ends for key, ends in LOADS.items()}
    term = Term(form, (1.0,))
    correction = Correction((term,), (term,), ranges)
    there, border = term.energy(rows), term.energy(rows.within(ranges))
    np.testing.assert_allclose(correction.added_energy(rows, planned=False), there if holds else border)
    assert abs(there - border) > 0.1
    assert correction.beyond(rows), "what no run has shown is said of laws too"


def test_a_drift_over_the_clock_begins_anew_each_day():
    """Runs at 8 and 12 o'clock of two days; what is predicted later counts from the first stamp that is known."""
    hour = 3600.0
    rows = even(4, clock_s=np.array([8.0, 12.0, 32.0, 35.0]) * hour)
    form = next(f for f in Drift.variants(rows) if f.over == "clock" and not f.of_all)
    assert (form.start, form.end) == ((8.0 * hour, 32.0 * hour), 4.0 * hour)
    np.testing.assert_allclose(form.column(rows), [0.0, 4.0, 0.0, 3.0])
    other = even(4, clock_s=np.array([10.0, 32.5, 80.0, 90.0]) * hour)  # on both days, and on a third
    np.testing.assert_allclose(form.column(other), [2.0, 0.5, 0.0, 4.0])  # up to the four hours of the runs


def test_what_comes_first_are_the_declared_numbers():
    form = BaseParameters.of(charge=False)
    added = dict(zip(form.coefficient_names(), form.columns(even())[0], strict=True))
    assert added["rolling_resistance"] == pytest.approx(W)
    assert added["energy_of_motion"] == pytest.approx(MOTION)
    assert added["idle_power_w"] == pytest.approx(2.0)
    lowest = dict(zip(form.coefficient_names(), form.lowest(even()), strict=True))
    assert lowest["rolling_resistance"] == -ROBOT.rolling_resistance  # none of them may become negative
    assert lowest["idle_power_w"] == -ROBOT.idle_power_w
    for one in (form, BaseParameters.of(charge=True)):
        assert form_from_dict(json.loads(json.dumps(one.as_dict(), allow_nan=False))) == one
        assert len(one.units("J")) == len(one.lowest(even())) == one.columns(even(2)).shape[1]


@pytest.mark.parametrize("slope", [0.1, -0.05, -0.1, -0.2])
@pytest.mark.parametrize("more", [0.05, -0.05])
@pytest.mark.parametrize("regeneration", [0.0, 0.3])
def test_drives_pull_or_brake_against_all_that_resists(slope, more, regeneration):
    """Closed form: F s where the whole force F is positive, and the regenerated share of it where it is not."""
    rows = even(grade=[slope], grades=[[slope] * 5], traction_per_m=[(0.08 + slope) * W])
    rows = replace(rows, robot=replace(ROBOT, regeneration=regeneration), drives=Drives(resisted_tan=0.0))
    base = BaseParameters.of(charge=False)
    start = Term(base, (0.0,) * len(base.names))
    correction = Correction((start, Term(RollingResistance(), (more,))), (), first_base=start)
    force = (0.08 + slope + more) * W
    motion = rows.base_motion + correction.added_energy(rows, planned=False)
    np.testing.assert_allclose(motion, force if force > 0.0 else regeneration * force, atol=1e-9)


def test_files_with_unknown_forms_or_settings_are_refused():
    with pytest.raises(ModelError, match="form 'magic', which this version does not know"):
        form_from_dict({"form": "magic"})
    with pytest.raises(ModelError, match=r"'curve' needs the settings \['centred', 'knots', .*\['knots'\]"):
        form_from_dict({"form": "curve", "knots": [0.0, 1.0]})
    with pytest.raises(ModelError, match=r"'turning' has settings that this version does not know: \['tight'\]"):
        form_from_dict({"form": "turning", "tight": True})


def test_a_model_of_a_version_in_which_fast_turns_cost_less_is_read_where_they_do_not():
    written = {"form": "turning", "limit_radps": None, "limit_per_m": 0.2, "eases": False}
    assert form_from_dict(written) == Turning(0.2)
    with pytest.raises(ModelError, match=r"does not know: \['limit_radps'\]. Calibrate again"):
        form_from_dict(written | {"limit_radps": 0.2})


def test_no_form_of_turning_depends_on_the_speed():
    """What a radian takes at another speed is for a curve over the speed to say."""
    rows = made_up(np.random.default_rng(5))
    slow = replace(rows, duration_s=2.0 * rows.duration_s)
    assert list(Turning.variants(rows)) == [Turning()]
    for form in Turning.variants(rows):
        np.testing.assert_array_equal(form.columns(slow), form.columns(rows))


def test_plans_pay_for_all_turning_that_was_found_and_for_nothing_else():
    """14 J/rad for every radian; of a second effect of turning what least squares of it on the angle say.

    One turn in a hundred lies beyond the driven range.
    """
    rows = made_up(np.random.default_rng(5))
    usual = rows.turned_abs_rad <= np.quantile(rows.turned_abs_rad[~rows.standing], 0.99)
    turned = rows.turned_abs_rad * usual
    gentle = np.minimum(turned, 0.3)
    terms = [Term(Turning(), (14.0,)), Term(Turning(0.3), (100.0,)), Term(HotelLoad(), (5.0,))]
    assert turning_per_rad(terms, rows) == pytest.approx(14.0 + 100.0 * (turned @ gentle) / (turned @ turned))
    assert turning_per_rad(terms[2:], rows) == 0.0
    always = Term(Curve("turning", (0.0, 0.5, 1.0), centred=False), (3.0, 3.0, 3.0))  # straight on as well
    assert always.form.name == "turning"
    assert turning_per_rad([always], rows) == pytest.approx(0.0, abs=1e-9)


def test_where_an_effect_acts_is_said():
    assert Turning().where((50.0,)) == "everywhere"
    assert Turning(0.2).where((50.0,)) == "everywhere; a curve of a radius below 5 m takes no more current"
    assert PowerLimit(230.0).where((-0.5,)) == "above 230 W"
    field = PlaceField(((0.0, 0.0), (100.0, 0.0)), 4.0)
    assert field.where((0.01, -0.08)) == "a field over the map, strongest about x 100.0, y 0.0: -0.08"


def test_forms_are_called_by_plain_names_and_say_what_to_drive():
    rows = made_up(np.random.default_rng(1))
    forms = [form for kind in (*NAMED, *CHANGES, *UNNAMED) for form in kind.variants(rows)]
    titles = {form.title for form in forms}
    assert {"turning", "late power readings", "structure in heading", "temperature"} <= titles
    words = [*titles, *(form.reveals for form in forms), *(form.meaning for form in forms)]
    assert [text for text in words if PRIVATE.search(text)] == []
    assert all(words)
    named = {form.name: form.title for form in forms}
    assert len(set(named.values())) == len(named)  # two effects never look the same to a reader
    for key, form in FORMS.items():
        assert form.key == key


def test_only_what_is_known_before_a_drive_is_planned_with():
    before = (Turning(), CrossSlope(), Wind(), Temperature(5.0), Climbing(), TerrainClass("terrain", ("mud",)))
    known = {form.name: form.known_before for form in before}
    assert all(known.values())
    lasting = (Drift("clock"), Reversing(), MeterLag(), MapShift(), TerrainClass("driver", ("anna",)))
    assert not any(form.known_before for form in lasting)
    assert Curve("heading", (0.0, 3.0)).known_before
    assert Curve("column:temperature", (0.0, 3.0)).known_before
    assert not Curve("column:motor_temperature", (0.0, 3.0)).known_before
    assert not Curve("since_start", (0.0, 3.0)).known_before
