"""Calibration of made-up drives: what was put in is found, nothing is invented, and hostile input is answered."""

import json
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.energy.metrics import errors_of
from joulemap.model.errors import ModelError, RunsError
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.loop.report import report_document
from joulemap.model.runs.features import concatenate_features
from joulemap.model.runs.record import RECORD_FILE, read_record, save_record
from joulemap.model.runs.refused_columns import refused_columns
from tests.reference.drives import ROBOT, found_in, made_up, measured_on, noisy, smooth_noise, stops

BEFORE = {"name": "made up", "version": "1"}

EFFECTS = {
    "turning": lambda rows: 60.0 * rows.turned_abs_rad,
    "cross_slope": lambda rows: 0.9 * ROBOT.weight_n * rows.cross_abs * rows.pulling,
    "roughness": lambda rows: 5.0 * ROBOT.weight_n * rows.roughness_m * rows.pulling,
}


def wet_patch(rows):
    return 25.0 * (np.hypot(rows.x - 25, rows.y - 25) < 8.0)


def test_a_patch_is_named_where_baseline_runs_say_what_the_ground_was():
    """Without them it may be an error of the map or of the model at that place."""
    rng = np.random.default_rng(7)
    rows, dry = made_up(rng), made_up(rng)
    now, before = noisy(rng, rows, wet_patch(rows)), noisy(rng, dry, 0.0 * wet_patch(dry))
    found = found_in(rows, now, base=measured_on(dry, before))
    assert found.effects[0].term.form.name == "local_friction"
    assert not found_in(rows, now).effects


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_is_named_first(name):
    rng = np.random.default_rng(7)
    rows = made_up(rng)
    found = found_in(rows, noisy(rng, rows, EFFECTS[name](rows)))
    assert found.effects[0].term.form.name == name
    assert found.effects[0].p_value < 0.01
    assert found.errors["after"]["mean_relative"] < 0.09  # the noise alone: 0.07 x sqrt(2 / pi) = 0.056
    if name == "turning":
        assert found.effects[0].low[0] < 60.0 < found.effects[0].high[0]


@pytest.mark.parametrize("runs", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_a_declared_idle_power_far_off_changes_nothing(runs):
    """400 W where 5 W are drawn are twenty times the energy of a metre. The stops show it, with what is left of braking
    in them."""
    rng = np.random.default_rng(0)
    moving, others = made_up(rng, runs=runs), made_up(rng, runs=2)
    still = stops(rng, moving)
    rows = concatenate_features([moving, still])
    energy = _with_turning(rng, rows)
    energy[len(moving) :] += np.abs(rng.normal(0.0, 60.0, len(still)))
    other_energy = _with_turning(rng, others)

    def _errors(declared_w):
        robot = replace(ROBOT, idle_power_w=declared_w)
        found = found_in(replace(rows, robot=robot), energy)
        assert [e.term.form.name for e in found.effects] == ["turning"]
        assert found.effects[0].low[0] < 60.0 < found.effects[0].high[0]
        assert found.fitted.base.by_name["idle_power_w"] + declared_w == pytest.approx(5.0, abs=1.0)
        return found.errors_on(measured_on(replace(others, robot=robot), other_energy))["after"]["rmse"]

    right = _errors(5.0)
    assert right < 6.0  # the noise: 7 % of 47 J and of turning
    assert _errors(400.0) == pytest.approx(right, rel=0.1)


def _with_turning(rng, rows):
    """Of a robot that draws 5 W at rest."""
    return noisy(rng, replace(rows, robot=replace(ROBOT, idle_power_w=5.0)), EFFECTS["turning"](rows))


def test_low_ground_and_driving_backwards_have_names():
    """Each alone: wet low ground, and a gear that drags backwards."""
    rng = np.random.default_rng(17)
    rows = made_up(rng)
    back = smooth_noise(rng, len(rows)) > 0.8
    compass = np.degrees(rows.heading_rad) + np.where(back, 180.0, 0.0) + rng.normal(0.0, 2.0, len(rows))
    rows = replace(rows, columns=rows.columns | {"heading": compass % 360.0})
    wet = found_in(rows, noisy(rng, rows, 20.0 * np.clip(-rows.position_index_m / 0.05, 0.0, 2.0)))
    assert wet.effects[0].term.form.name == "learned:position_index"
    dragging = found_in(rows, noisy(rng, rows, 25.0 * back)).effects[0].term.form
    assert dragging.name == "reversing"
    assert not dragging.known_before  # plans drive forwards


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
def test_nothing_is_found_where_nothing_is(seed):
    rng = np.random.default_rng(100 + seed)
    rows = made_up(rng)
    found = found_in(rows, noisy(rng, rows))
    assert not found.effects
    assert found.errors["corrected"] == found.errors["after"]
    report = report_document(found, before=BEFORE, after="2")
    assert report["verdict"] == "nothing_found"
    json.dumps(report, allow_nan=False)


def test_errors_are_of_calibrations_that_had_no_part_of_the_run():
    """By hand: the same procedure without the first run, applied to it."""
    rng = np.random.default_rng(7)
    rows = made_up(rng, runs=4, each=80)
    energy = noisy(rng, rows, EFFECTS["turning"](rows))
    found = found_in(rows, energy, cross_validate=True)
    assert found.folds == 4
    first = measured_on(rows, energy).run == 0
    others = found_in(rows.take(~first), energy[~first])
    expected = others.errors_on(measured_on(rows.take(first), energy[first]))
    mine = errors_of(found.residuals.take(first), found.held_out["after"][first])
    assert mine["rmse"] == pytest.approx(expected["after"]["rmse"], rel=1e-6)
    fitted = found_in(rows, energy)
    assert fitted.folds == 0
    assert found.errors["after"]["rmse"] > fitted.errors["after"]["rmse"]  # the fit's own error is too small
    before = [one.errors["before"] for one in (found, fitted)]
    assert before[0] == before[1]


def test_groups_of_runs_are_left_out_together():
    rng = np.random.default_rng(7)
    rows = made_up(rng, each=40)
    energy = noisy(rng, rows, EFFECTS["turning"](rows))
    days = ["monday", "monday", "tuesday", "tuesday", "friday", "friday"]
    found = found_in(rows, energy, cross_validate=True, groups=days)
    assert found.folds == 3
    assert report_document(found, before=BEFORE, after="2")["validation"] == {
        "folds": 3,
        "left_out": "runs",
        "whole_procedure": True,
    }


def test_errors_by_hand():
    """Of 10, 20 and 40 J predicted with 12, 20 and 30 J; a fourth that is not positive has no relative error."""
    rows = made_up(np.random.default_rng(0), runs=1, each=24)
    energy = np.tile([10.0, 20.0, 40.0, -4.0], 6)
    errors = errors_of(measured_on(rows, energy), np.tile([12.0, 20.0, 30.0, -4.0], 6))
    assert errors["mean_relative"] == pytest.approx((0.2 + 0.0 + 0.25) / 3.0)
    assert errors["absolute_share"] == pytest.approx(12.0 / 74.0)
    assert errors["rmse"] == pytest.approx(np.sqrt((4.0 + 100.0) / 4.0))
    assert errors["bias"] == pytest.approx((-2.0 + 10.0) / 4.0)
    assert errors["by_run"] == {"run0": pytest.approx(errors["mean_relative"])}


def test_hostile_columns_are_refused_with_a_reason():
    rng = np.random.default_rng(3)
    rows = made_up(rng)
    measured = noisy(rng, rows, EFFECTS["turning"](rows))
    power = measured / rows.duration_s
    odd = rng.standard_normal(len(rows))
    hostile = {
        "flat": np.full(len(rows), 3.0),
        "odd": odd,
        "odder": odd.copy(),
        "sneaky": 2.0 * power + 5.0,
        "voltage_2": 28.0 - 0.01 * power,
        "empty": np.full(len(rows), np.nan),
    }
    found = found_in(replace(rows, columns=rows.columns | hostile), measured, electric={"power": power})
    assert "turning" in [e.term.form.name for e in found.effects]
    assert not [e for e in found.effects if e.term.form.name.removeprefix("learned:") in hostile]
    assert found.refused["flat"] == "constant (3)"
    assert found.refused["odder"] == "identical to odd"
    assert "copy of the power" in found.refused["sneaky"]
    assert "part of the measurement" in found.refused["voltage_2"]
    assert "0% of the segments" in found.refused["empty"]
    assert not {"odd", "temperature"} & set(found.refused)


def test_what_sinks_while_another_rises_is_no_copy_of_it():
    rng = np.random.default_rng(4)
    rows = made_up(rng)
    measured = noisy(rng, rows, EFFECTS["turning"](rows))
    load = measured / rows.duration_s
    warm = rows.clock_s / 3600.0 + 0.1 * rng.standard_normal(len(rows))
    volts = 29.0 - 0.3 * rows.clock_s / 3600.0 - 0.002 * load  # a day's discharge, and the sag under load
    assert abs(np.corrcoef(warm, volts)[0, 1]) > 0.95
    columns = rows.columns | {"warm": warm, "sagging": 3.0 * volts - 7.0}
    refused = refused_columns(measured_on(replace(rows, columns=columns), measured), {"voltage": volts})
    assert "warm" not in refused
    assert "copy of the voltage" in refused["sagging"]


def test_a_pitch_on_hills_is_no_copy_of_the_energy_and_a_noisy_copy_is():
    """Climbs so steep that pitch goes with the energy, and still more closely with the grade."""
    rng = np.random.default_rng(5)
    rows = made_up(rng)
    rows = replace(rows, traction_per_m=ROBOT.weight_n * (0.5 + 4.0 * rows.grade), grade=4.0 * rows.grade)
    measured = rows.predicted + rng.normal(0.0, 0.1 * rows.predicted.std(), len(rows))
    pitch = np.degrees(np.arctan(rows.grade)) + rng.normal(0.0, 0.5, len(rows))
    copy = measured + rng.normal(0.0, 0.05 * measured.std(), len(rows))
    assert abs(np.corrcoef(pitch, measured)[0, 1]) > 0.95
    columns = {"incline": pitch, "pitch": pitch, "copy": copy}
    residuals = measured_on(replace(rows, columns=columns), measured)
    refused = refused_columns(residuals, {"energy": residuals.measured})
    assert set(refused) == {"copy", "pitch"}
    assert "the measured pitch is a base parameter" in refused["pitch"]
    assert "copy of the energy" in refused["copy"]


def test_a_second_meter_under_an_innocent_name_is_no_cause():
    """It follows what the model predicts and what it does not predict alike; a wind follows the second only."""
    rng = np.random.default_rng(9)
    rows = made_up(rng)
    gusts = 3.0 + smooth_noise(rng, len(rows))
    measured = noisy(rng, rows, 12.0 * gusts)
    clamp = measured / rows.duration_s * (1.0 + 0.02 * rng.standard_normal(len(rows)))
    refused = refused_columns(measured_on(replace(rows, columns={"clamp": clamp, "gusts": gusts}), measured), {})
    assert "it is another meter" in refused["clamp"]
    assert "gusts" not in refused


@pytest.mark.parametrize("runs", [1, 2])
def test_one_or_two_runs_cannot_show_a_shift_of_whole_runs(runs):
    rng = np.random.default_rng(5)
    rows = made_up(rng, runs=runs, each=150)
    found = found_in(rows, noisy(rng, rows, 0.15 * rows.predicted))
    assert not found.effects


def on_two_grounds(rng):
    """A drive over grass and loam in long stretches."""
    rows = made_up(rng)
    loam = np.concatenate([np.roll(np.arange(120) // 30 % 2, 15 * k) for k in range(6)]).astype(bool)
    return replace(rows, words={"terrain": np.where(loam, "loam", "grass")}), loam


def test_an_interaction_is_found_with_the_effects_that_it_joins():
    rng = np.random.default_rng(12)
    rows, loam = on_two_grounds(rng)
    turned = rows.turned_abs_rad
    found = found_in(rows, noisy(rng, rows, 30.0 * turned + 12.0 * loam + 50.0 * turned * loam))
    effects = {e.term.form.name: e for e in found.effects}
    assert set(effects) >= {"turning", "terrain_class", "turning x terrain_class"}
    crossed = effects["turning x terrain_class"]
    sign = 1.0 if crossed.term.form.classes == ("loam",) else -1.0
    assert sign * crossed.term.coefficients[0] == pytest.approx(
        50.0, abs=3.0 * (crossed.high[0] - crossed.low[0]) / 4.0
    )


def test_one_direction_only_says_nothing_of_the_heading():
    rng = np.random.default_rng(9)
    rows = made_up(rng, heading=1.0)
    found = found_in(rows, noisy(rng, rows, 0.2 * rows.predicted))
    assert "learned:heading" not in [e.term.form.name for e in found.effects]


@pytest.mark.parametrize("charge", [False, True])
def test_level_runs_say_nothing_of_slopes(charge):
    """A robot that needs twice the declared energy, on level ground: it may be heavier, or roll on softer ground. On a
    slope of either direction the base model is left as it was, beside what was found."""
    rng = np.random.default_rng(7)
    rows = made_up(rng)
    level = rows.tilted(-rows.grade)
    energy = 2.0 * noisy(rng, level, EFFECTS["turning"](level)) / (24.0 if charge else 1.0)
    units = replace(level, unit_j=24.0 if charge else 1.0)
    found = calibrate(measured_on(units, energy, charge=charge), cross_validate=False)
    assert [e.term.form.name for e in found.effects] == ["turning"]
    assert not {"energy_of_motion", "descents", "uphill", "downhill", "measured_slope"} & set(found.fitted.base.by_name)
    correction = found.fitted.correction
    assert correction.drives.coasting_shift == 0.0
    for tilt in (0.3, -0.3):  # beyond coasting
        steep = units.tilted(np.full(len(units), tilt))
        here, there = (
            correction.added_energy(rows, planned=True) - charge * rows.base_motion for rows in (units, steep)
        )
        np.testing.assert_allclose(there, here, rtol=1e-9)
    assert np.median(here) > 0.0


def test_runs_beside_the_map_are_an_error_with_a_number():
    rng = np.random.default_rng(1)
    rows = made_up(rng)
    off = replace(rows, traction_per_m=np.full(len(rows), np.nan))
    with pytest.raises(RunsError, match=r"only 0 of 720 segments"):
        found_in(off, noisy(rng, rows))


def test_what_the_base_runs_show_too_is_no_news():
    rng = np.random.default_rng(11)
    base, new = made_up(rng), made_up(rng)
    known = measured_on(base, noisy(rng, base, EFFECTS["turning"](base)))
    assert not found_in(new, noisy(rng, new, EFFECTS["turning"](new)), base=known).effects


def test_a_record_of_runs_comes_back(tmp_path):
    rng = np.random.default_rng(2)
    rows = made_up(rng, runs=2)
    kept = measured_on(rows, noisy(rng, rows))
    written = save_record(tmp_path, kept)
    back = read_record(tmp_path, kept=written)
    assert back is not None
    np.testing.assert_array_equal(back.measured, kept.measured)
    np.testing.assert_array_equal(back.said, kept.said)
    np.testing.assert_array_equal(back.features.columns["temperature"], kept.features.columns["temperature"])
    assert back.runs == ("run0", "run1")


def test_a_record_that_lacks_something_is_refused(tmp_path):
    rng = np.random.default_rng(2)
    rows = made_up(rng, runs=2)
    save_record(tmp_path, measured_on(rows, noisy(rng, rows)))
    file = tmp_path / RECORD_FILE
    whole = file.read_bytes()
    file.write_bytes(whole[:300] + bytes([whole[300] ^ 1]) + whole[301:])  # in the first of the arrays
    with pytest.raises(ModelError, match="is damaged"):
        read_record(tmp_path)
    file.write_bytes(whole)
    with np.load(file) as arrays:
        kept = {key: arrays[key] for key in arrays.files if key != "grade"}
    np.savez(file, **kept)
    with pytest.raises(ModelError, match="lacks grade"):
        read_record(tmp_path)
    file.write_bytes(b"no archive")
    with pytest.raises(ModelError, match="damaged"):
        read_record(tmp_path)


@pytest.mark.parametrize("baseline", [False, True])
def test_a_bearing_that_fails_between_two_runs_is_a_change_in_time(baseline):
    """Runs 4 to 6 of 6 cost 27 % more. Plans do not contain it: somebody has to look at the robot."""
    rng = np.random.default_rng(5)
    rows, before = made_up(rng), made_up(rng)
    base = measured_on(before, noisy(rng, before)) if baseline else None
    found = found_in(rows, noisy(rng, rows, 0.27 * rows.predicted * (rows.run >= 3)), base=base)
    form = found.effects[0].term.form
    assert (form.name, form.run) == ("change", 4)
    assert found.effects[0].term.coefficients[0] == pytest.approx(0.27, abs=0.04)
    assert "from run 4 on" in form.where(found.effects[0].term.coefficients)
    assert not form.known_before


def test_a_run_that_differs_is_no_change_in_time():
    rng = np.random.default_rng(6)
    rows = made_up(rng)
    found = found_in(rows, noisy(rng, rows, 0.27 * rows.predicted * (rows.run == 3)))
    assert "change" not in [effect.term.form.name for effect in found.effects]


def test_no_effect_takes_or_gives_back_more_than_all_the_energy():
    rng = np.random.default_rng(8)
    rows = made_up(rng)
    measured = measured_on(rows, noisy(rng, rows))
    design = calibrate(measured, cross_validate=False).fitted.selection.design
    for candidate in design.candidates:
        columns, form = design.columns[:, candidate.tested], candidate.form
        low, high = design.low[candidate.tested], design.high[candidate.tested]
        if not form.on_map:
            continue
        assert np.isfinite([low, high]).all(), form.name
        size, energy = np.abs(columns), np.maximum(measured.measured, measured.said)
        expensive = np.maximum(energy, np.quantile(energy, 0.95))  # what its rows may take without it
        for limit, most in ((high, energy), (-low, expensive)):
            assert (size.sum(axis=0) * limit <= (size > 0.0).T @ most * (1.0 + 1e-9)).all(), form.name
    slip = [c.form for c in design.candidates if c.form.name == "slip"]
    assert [form.low for form in slip] == [0.0]
