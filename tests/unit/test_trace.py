"""Tracing residuals: effects put into made-up drives are found, nothing is invented, and hostile input is answered."""

import json
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import ConflictError, ModelError, RunsError
from joulemap.model.loop import calibration
from joulemap.model.loop.bounds import bounded
from joulemap.model.loop.calibrated import Correction, read_calibrated, save_calibrated
from joulemap.model.loop.columns import usable_columns
from joulemap.model.loop.drive import _with_stands
from joulemap.model.loop.effects import Term, inside
from joulemap.model.loop.fitting import Fit, fit_terms
from joulemap.model.loop.record import RECORD_FILE, read_record, save_record
from joulemap.model.loop.report import report_document
from joulemap.model.loop.residual import residuals_of
from joulemap.model.loop.shared import SharedErrors
from tests.reference.drives import ROBOT, found_in, made_up, noisy, smooth_noise

BEFORE = {"name": "made up", "version": "1"}

EFFECTS = {
    "turning": lambda d: 60.0 * d.turned_abs_rad,
    "braking": lambda d: 0.9 * ROBOT.weight_n * np.maximum(-d.grade, 0.0),
    "cross_slope": lambda d: 0.9 * ROBOT.weight_n * d.cross_abs,
    "sensor_gain": lambda d: 0.2 * d.predicted,
    "local_friction": lambda d: 25.0 * (np.hypot(d.x - 25, d.y - 25) < 8.0),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_is_named_first(name):
    rng = np.random.default_rng(7)
    drive = made_up(rng)
    found = found_in(drive, noisy(rng, drive, EFFECTS[name](drive)))
    same = {"local_friction": {"local_friction", "learned:place"}, "sensor_gain": {"sensor_gain", "payload"}}
    assert found.effects
    assert found.effects[0].term.name in same.get(name, {name})
    assert found.effects[0].p_value < 0.05
    assert found.after["mean_relative"] < 0.09  # the noise alone: 0.07 x sqrt(2 / pi) = 0.056
    if name in ("turning", "braking"):
        true = {"turning": 60.0, "braking": 0.9}[name]
        if len(found.effects[0].low) == 1:
            assert found.effects[0].low[0] < true < found.effects[0].high[0]


def test_cost_of_low_ground_backwards_driving_and_a_heater_have_names():
    """Each alone: wet low ground, a gear that drags backwards, and a heater of 1.5 W per degree below 25."""
    rng = np.random.default_rng(17)
    drive = made_up(rng)
    back = smooth_noise(rng, len(drive)) > 0.8
    compass = np.degrees(drive.heading_rad) + np.where(back, 180.0, 0.0) + rng.normal(0.0, 2.0, len(drive))
    drive = replace(drive, columns=drive.columns | {"heading": compass % 360.0})
    wet = found_in(drive, noisy(rng, drive, 20.0 * np.clip(drive.hollow_m / 0.05, 0.0, 2.0)))
    assert wet.effects[0].term.name == "learned:hollow"
    dragging = found_in(drive, noisy(rng, drive, 25.0 * back)).effects[0]
    assert dragging.term.name == "reversing"
    assert not dragging.planner  # plans drive forwards
    heater_j = 1.5 * (25.0 - drive.columns["temperature"]) * drive.duration_s
    heated = found_in(drive, noisy(rng, drive, heater_j)).effects[0]
    assert heated.term.units[-1] == "W/K"
    assert heated.low[-1] < -1.5 < heated.high[-1]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_robot_declared_without_idle_power_is_calibrated():
    """Nothing is predicted while it is stationary, and nothing downhill; it draws 12 W and turns at 60 J/rad."""
    rng = np.random.default_rng(7)
    drive = replace(made_up(rng), robot=replace(ROBOT, idle_power_w=0.0))
    drive = _with_stands(drive, np.repeat(np.arange(6), 3), np.full(18, 10.0))
    assert (drive.predicted == 0.0).sum() > 18  # stationary, and steep descents
    drawn = noisy(rng, replace(drive, robot=ROBOT), EFFECTS["turning"](drive))
    found = {e.term.name: float(e.coefficients[0]) for e in found_in(drive, drawn).effects}
    assert found["hotel_load"] == pytest.approx(12.0, rel=0.1)
    assert found["turning"] == pytest.approx(60.0, rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_found_where_nothing_is(seed):
    rng = np.random.default_rng(100 + seed)
    drive = made_up(rng)
    found = found_in(drive, noisy(rng, drive))
    assert not found.effects
    assert found.before == found.corrected == found.after
    report = report_document(found, before=BEFORE, after=None)
    assert report["verdict"] == "nothing_found"
    json.dumps(report, allow_nan=False)


def test_hostile_columns_are_refused_with_a_reason():
    rng = np.random.default_rng(3)
    drive = made_up(rng)
    measured = noisy(rng, drive, EFFECTS["turning"](drive))
    power = measured / drive.duration_s
    odd = rng.standard_normal(len(drive))
    hostile = {
        "flat": np.full(len(drive), 3.0),
        "odd": odd,
        "odder": odd.copy(),
        "sneaky": 2.0 * power + 5.0,
        "voltage_2": 28.0 - 0.01 * power,
        "empty": np.full(len(drive), np.nan),
    }
    found = found_in(replace(drive, columns=drive.columns | hostile), measured, electric={"power": power})
    assert [e.term.name for e in found.effects] == ["turning"]
    assert found.refused["learned:flat"] == "constant (3)"
    assert found.refused["learned:odder"] == "identical to odd"
    assert "copy of the power" in found.refused["learned:sneaky"]
    assert "part of the measurement" in found.refused["learned:voltage_2"]
    assert "0% of the segments" in found.refused["learned:empty"]


def test_what_sinks_while_another_rises_is_no_copy_of_it():
    rng = np.random.default_rng(4)
    drive = made_up(rng)
    measured = noisy(rng, drive, EFFECTS["turning"](drive))
    load = measured / drive.duration_s
    warm = drive.clock_s / 3600.0 + 0.1 * rng.standard_normal(len(drive))
    volts = 29.0 - 0.3 * drive.clock_s / 3600.0 - 0.002 * load  # a day's discharge, and the sag under load
    assert abs(np.corrcoef(warm, volts)[0, 1]) > 0.95
    columns = drive.columns | {"warm": warm, "sagging": 3.0 * volts - 7.0}
    found = found_in(replace(drive, columns=columns), measured, electric={"voltage": volts})
    assert "learned:warm" not in found.refused
    assert "copy of the voltage" in found.refused["learned:sagging"]


def test_a_pitch_on_hills_is_no_copy_of_the_energy_and_a_noisy_copy_is():
    """Climbs so steep that pitch goes with the energy, and still more closely with the grade."""
    rng = np.random.default_rng(5)
    drive = made_up(rng)
    drive = replace(drive, traction_per_m=ROBOT.weight_n * (0.5 + 4.0 * drive.grade), grade=4.0 * drive.grade)
    measured = drive.predicted + rng.normal(0.0, 0.1 * drive.predicted.std(), len(drive))
    pitch = np.degrees(np.arctan(drive.grade)) + rng.normal(0.0, 0.5, len(drive))
    copy = measured + rng.normal(0.0, 0.05 * measured.std(), len(drive))
    assert abs(np.corrcoef(pitch, measured)[0, 1]) > 0.95
    residuals = residuals_of(replace(drive, columns={"pitch": pitch, "copy": copy}), measured, ("run",), charge=False)
    refused = {}
    assert usable_columns(residuals, {"energy": residuals.measured}, refused) == ["pitch"]
    assert "copy of the energy" in refused["learned:copy"]


def test_a_wind_nobody_logged_is_a_diagnosis_and_acts_in_these_runs_only():
    rng = np.random.default_rng(6)
    drive = made_up(rng)
    before = drive.traction_per_m
    felt = np.maximum(before + 14.0 * np.cos(drive.heading_rad - 1.0), 0.0) - np.maximum(before, 0.0)
    (effect,) = found_in(drive, noisy(rng, drive, felt)).effects
    assert (effect.term.name, effect.planner) == ("wind", False)
    np.testing.assert_allclose(effect.term.energy(drive), felt, atol=4.0)
    elsewhere = replace(drive, runs=tuple(f"later{k}@0" for k in range(6)))
    assert not effect.term.energy(elsewhere).any()


def test_ruts_that_scale_the_motion_are_no_wind():
    rng = np.random.default_rng(6)
    drive = made_up(rng)
    drive = replace(drive, traction_per_m=np.maximum(drive.traction_per_m, 0.0))
    found = found_in(drive, noisy(rng, drive, 0.4 * np.cos(drive.heading_rad - 1.0) * drive.motion_part))
    assert found.effects[0].term.name == "learned:heading"
    assert found.effects[0].term.settings["of_motion"]
    assert found.effects[0].term.coefficients == pytest.approx([0.4 * np.sin(1.0), 0.4 * np.cos(1.0)], abs=0.06)


def test_a_word_that_changes_once_is_told_by_the_step_from_what_differs_between_runs():
    rng = np.random.default_rng(8)
    drive = made_up(rng)
    sand = np.arange(len(drive)) > 4.5 * 120  # halfway through the fifth run of six
    drive = replace(drive, words={"terrain": np.where(sand, "sand", "grass")})
    found = found_in(drive, noisy(rng, drive, 0.4 * drive.motion_part * sand))
    assert found.effects[0].term.name == "terrain_class"


def test_cost_that_grows_with_warmth_is_not_called_temperature():
    rng = np.random.default_rng(8)
    drive = made_up(rng)
    warmth = drive.columns["temperature"] - 17.5
    grows, falls = (found_in(drive, noisy(rng, drive, sign * 4.0 * warmth)) for sign in (1.0, -1.0))
    assert grows.effects[0].term.name in ("learned:temperature", "drift")
    assert falls.effects[0].term.name == "temperature"


@pytest.mark.parametrize("runs", [1, 2])
def test_one_or_two_runs_cannot_show_a_shift_of_whole_runs(runs):
    rng = np.random.default_rng(5)
    drive = made_up(rng, runs=runs, each=150)
    found = found_in(drive, noisy(rng, drive, 0.15 * drive.predicted))
    assert not [e for e in found.effects if e.p_value < 0.05]


def on_two_grounds(rng):
    """A drive over grass and loam in long stretches."""
    drive = made_up(rng)
    loam = np.concatenate([np.roll(np.arange(120) // 30 % 2, 15 * k) for k in range(6)]).astype(bool)
    return replace(drive, words={"terrain": np.where(loam, "loam", "grass")}), loam


def test_an_interaction_is_found_with_the_effects_that_it_joins():
    rng = np.random.default_rng(12)
    drive, loam = on_two_grounds(rng)
    turned = drive.turned_abs_rad
    found = found_in(drive, noisy(rng, drive, 30.0 * turned + 12.0 * loam + 50.0 * turned * loam))
    effects = {e.term.name: e for e in found.effects}
    assert set(effects) == {"turning", "terrain_class", "turning x terrain_class"}
    for effect in effects.values():
        assert effect.p_value < 0.05
        assert effect.share > 0.02
        assert not effect.term.where  # where they differ is the interaction's to say
    both = sum(e.term.energy(drive) for e in found.effects)
    rad = np.array(
        [both[(turned > 0.5) & where].sum() / turned[(turned > 0.5) & where].sum() for where in (loam, ~loam)]
    )
    np.testing.assert_allclose(rad[0] - rad[1], 50.0 + 12.0 / turned[(turned > 0.5) & loam].mean(), rtol=0.25)


def test_progress_moves_with_every_round_and_ends_at_one():
    rng = np.random.default_rng(12)
    drive, loam = on_two_grounds(rng)
    shares = []
    found_in(drive, noisy(rng, drive, (30.0 + 50.0 * loam) * drive.turned_abs_rad), progress=shares.append)
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert (shares[0] > 0.0, shares[-1]) == (True, 1.0)


def test_an_interaction_alone_brings_no_ground_along():
    rng = np.random.default_rng(13)
    drive, loam = on_two_grounds(rng)
    found = found_in(drive, noisy(rng, drive, 80.0 * drive.turned_abs_rad * loam))
    names = [e.term.name for e in found.effects]
    assert names
    assert set(names) <= {"turning", "turning x terrain_class"}


def test_a_battery_has_no_thousand_ohms():
    rng = np.random.default_rng(14)
    drive = made_up(rng)
    amps = drive.predicted / drive.duration_s / ROBOT.nominal_voltage_v
    found = found_in(drive, noisy(rng, drive, 40.0 * amps**2 * drive.duration_s))
    assert "battery" not in [e.term.name for e in found.effects]


def test_one_direction_only_says_nothing_of_wind():
    rng = np.random.default_rng(9)
    drive = made_up(rng, heading=1.0)
    found = found_in(drive, noisy(rng, drive, 0.2 * drive.predicted))
    assert not [e for e in found.effects if e.term.name in ("wind", "learned:heading")]


def test_runs_beside_the_map_are_an_error_with_a_number():
    rng = np.random.default_rng(1)
    drive = made_up(rng)
    off = replace(drive, traction_per_m=np.full(len(drive), np.nan))
    with pytest.raises(RunsError, match=r"only 0 of 720 segments"):
        found_in(off, noisy(rng, drive))


def test_what_the_base_runs_show_too_is_no_news():
    rng = np.random.default_rng(11)
    base, new = made_up(rng), made_up(rng)
    names = tuple(f"run{k}" for k in range(6))
    known = residuals_of(base, noisy(rng, base, EFFECTS["turning"](base)), names, charge=False)
    assert not found_in(new, noisy(rng, new, EFFECTS["turning"](new)), base=known).effects


def test_of_an_effect_only_what_the_base_runs_do_not_show_is_stated():
    """The base model is off by 0.3 along the formula everywhere: 0.9 more of it is what the new runs have."""
    rng = np.random.default_rng(19)
    term = Term("speed", "speed", ("",), {"power": 1, "absolute": False})
    past, drive = made_up(rng), made_up(rng)
    wrong, more = (c * ROBOT.weight_n for c in (0.3, 0.9))
    names = tuple(f"run{k}" for k in range(6))
    base = residuals_of(past, noisy(rng, past, wrong * term.columns(past)[:, 0]), names, charge=False)
    new = residuals_of(drive, noisy(rng, drive, (wrong + more) * term.columns(drive)[:, 0]), names, charge=False)
    fit = fit_terms(new, [term], base=base)
    assert fit.terms[0].coefficients[0] == pytest.approx(wrong + more, rel=0.15)
    assert fit.own[0][0] == pytest.approx(wrong, rel=0.3)
    assert fit.low[0][0] < more < fit.high[0][0]
    assert not fit_terms(new, [term]).own[0].any()


def test_where_an_effect_begins_is_fitted_and_in_doubt():
    rng = np.random.default_rng(23)
    drive = made_up(rng)
    uphill = replace(drive, grades=drive.grades + np.linspace(-0.03, 0.03, 5))
    truth = Term("turning", "turning", ("J/rad",), {"limit_radps": None}, {"over": "grade", "above": 0.02}, (30.0,))
    new = residuals_of(
        uphill, noisy(rng, uphill, truth.energy(uphill)), tuple(f"run{k}" for k in range(6)), charge=False
    )
    (term,), others = bounded(new, [replace(truth, where={"over": "grade", "above": 0.0})], [])
    assert term.where["above"] == pytest.approx(0.02, abs=0.015)
    alone, fit = fit_terms(new, [term]), fit_terms(new, [term], others=others)
    assert fit.low[0][0] < 30.0 < fit.high[0][0]
    assert others
    assert fit.high[0][0] - fit.low[0][0] > alone.high[0][0] - alone.low[0][0]


def test_a_metre_over_the_brow_is_partly_uphill_and_partly_downhill():
    drive = made_up(np.random.default_rng(2), each=40)
    brow = replace(drive, grades=np.tile([0.04, 0.02, 0.0, -0.02, -0.04], (len(drive), 1)))
    assert inside(brow, {"over": "grade", "above": 0.01}) == pytest.approx(0.375)  # trapezoids over a quarter metre
    down = Term("braking", "braking", ("",), {"from_grade": 0.0}, {}, (1.0,))
    assert down.energy(brow) == pytest.approx(ROBOT.weight_n * 0.01)
    assert down.energy(drive) == pytest.approx(ROBOT.weight_n * np.maximum(-drive.grade, 0.0))


def test_a_calibration_is_kept_whole_and_never_changed(tmp_path):
    turning = Term("turning", "turning", ("J/rad",), {"limit_radps": None}, {}, (60.0,))
    correction = Correction((turning,), (True,), turn_j_per_rad=60.0)
    version = save_calibrated(tmp_path, correction, {"name": "physics", "version": "1"})
    again, base, read = read_calibrated(tmp_path)
    assert (again.terms, base["name"], read) == ((turning,), "physics", version)
    with pytest.raises(ConflictError, match="never changed"):
        save_calibrated(tmp_path, correction, {"name": "physics", "version": "1"})
    file = tmp_path / "calibration.json"
    file.write_text(file.read_text().replace("60.0", "61.0"))
    with pytest.raises(ModelError, match="is not the calibration"):
        read_calibrated(tmp_path)


def test_a_record_of_runs_comes_back(tmp_path):
    rng = np.random.default_rng(2)
    drive = made_up(rng, runs=2)
    kept = residuals_of(drive, noisy(rng, drive), ("a", "b"), charge=False)
    save_record(tmp_path, kept)
    back = read_record(tmp_path)
    assert back is not None
    np.testing.assert_array_equal(back.residual, kept.residual)
    np.testing.assert_array_equal(back.drive.columns["temperature"], kept.drive.columns["temperature"])
    assert back.runs == ("a", "b")
    assert read_record(tmp_path / "elsewhere") is None
    with np.load(tmp_path / RECORD_FILE) as file:
        older = {key: file[key] for key in file.files if key != "grades"}
    np.savez(tmp_path / RECORD_FILE, **older)
    with pytest.raises(ModelError, match=r"lacks grades.*train the model again"):
        read_record(tmp_path)


def test_what_base_runs_show_as_well_is_no_news():
    """A patch that was as heavy when the base model's runs crossed it: nothing is found. Heavier by as much again: it
    is, by what is new."""
    rng = np.random.default_rng(12)
    patch = EFFECTS["local_friction"]
    before, after = made_up(rng), made_up(rng)
    names = tuple(f"run{k}" for k in range(6))
    base = residuals_of(before, noisy(rng, before, patch(before)), names, charge=False)
    same = noisy(rng, after, patch(after))
    assert found_in(after, same).effects  # without baseline runs it is new
    assert not found_in(after, same, base=base).effects
    more = found_in(after, noisy(rng, after, 2.5 * patch(after)), base=base).effects
    assert more[0].term.name in ("local_friction", "learned:place")


def test_cost_that_rises_through_the_day_is_a_drift_and_no_warmth():
    """Nothing that moves is known to be stiffer in warm air: a curve that says so gives way to the hours."""
    rng = np.random.default_rng(13)
    drive = made_up(rng)
    found = found_in(drive, noisy(rng, drive, 3.0 * drive.clock_s / 3600.0))
    assert [e.term.name for e in found.effects] == ["drift"]
    cold = found_in(drive, noisy(rng, drive, 3.0 * (20.0 - drive.columns["temperature"])))
    assert [e.term.name for e in cold.effects] == ["temperature"]


def test_a_small_effect_that_may_be_nil_is_none():
    """Of one effect found, with its interval as it is and moved to hold zero; a large one is kept all the same."""
    for strength, small in ((6.0, True), (80.0, False)):
        rng = np.random.default_rng(14)
        drive = made_up(rng)
        found = found_in(drive, noisy(rng, drive, strength * drive.turned_abs_rad))
        assert [e.term.name for e in found.effects] == ["turning"]
        term, low, high = found.effects[0].term, found.effects[0].low, found.effects[0].high
        assert low.size <= 2
        assert (found.effects[0].share < 0.2) is small

        def dropped(low, high, trace=found.trace, term=term):
            fit = Fit((term,), (np.zeros(low.size),), (low,), (high,), np.zeros(0))
            return calibration._idle(trace, calibration._Fitted(fit, [], [], trace.evidence.residuals), SharedErrors())

        assert dropped(low, high) is None
        assert dropped(-np.abs(high), np.abs(high)) is (found.trace.found[0] if small else None)


@pytest.mark.parametrize("seed", range(4))
def test_a_single_run_names_what_it_shows_and_nothing_else(seed):
    """Held out in parts; what differs between runs, as weather and hours do, cannot be asked of one."""
    rng = np.random.default_rng(200 + seed)
    drive = made_up(rng, runs=1, each=400)
    assert not found_in(drive, noisy(rng, drive)).effects
    turned = found_in(drive, noisy(rng, drive, EFFECTS["turning"](drive)))
    assert [e.term.name for e in turned.effects] == ["turning"]
