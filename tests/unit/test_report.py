"""What a reader of a calibration's report sees: sentences, names in the field's terms, and honest colour scales."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.chance import SHIFTS
from joulemap.model.loop.effects import Term
from joulemap.model.loop.report import coefficient_names, report_document, where_words
from joulemap.model.loop.words import LEAST_P, effect_name, left_out_words, p_words, quantity_name, repair_words
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.library.calibrations import CalibrationResult
from joulemap.service.loop.calibration import Calibrated
from joulemap.service.loop.deprecated_keys import with_former_keys
from joulemap.service.loop.next_drive import next_drive
from joulemap.service.loop.report_figures import LEAST_SPAN, change_scale
from joulemap.service.loop.report_page import report_page
from joulemap.service.loop.summary import (
    NextStep,
    error_states,
    error_words,
    found_words,
    headline,
    likeliest,
    summary_lines,
)
from tests.reference.drives import ROBOT, found_in, made_up, noisy
from tests.reference.words import PRIVATE, shown

BEFORE = {"name": "made up", "version": "1"}


def calibrated(measured, drive, **more):
    """A calibration with the report that `calibrate_on_runs` makes of it, without a map."""
    found = found_in(drive, measured)
    document = report_document(found, before=BEFORE, after="2" if found.terms else None)
    document |= {
        "route": {"why_not": "the runs have no positions"},
        "next_drive": {"why_not": "no route fits"},
        "runs": {"names": list(drive.runs), "rows": 7200, "repairs": {"run0": {"held_fixes": 2}}, "left_out": {}},
        "warnings": [],
    }
    return Calibrated(with_former_keys(document | more), found, None)


@pytest.fixture(scope="module")
def turning():
    rng = np.random.default_rng(12)
    drive = made_up(rng)
    return calibrated(noisy(rng, drive, 60.0 * drive.turned_abs_rad), drive)


@pytest.fixture(scope="module")
def nothing():
    rng = np.random.default_rng(13)
    drive = made_up(rng)
    return calibrated(noisy(rng, drive), drive)


def test_the_page_begins_with_what_was_found_how_much_better_it_is_and_what_to_type(turning):
    step = NextStep("Make a cost map with the calibrated model", "joulemap costmap dem.tif --model found/model")
    page = report_page(turning, None, steps=[step])
    text = shown(page)
    (effect,) = turning.document["effects"]
    (only,) = effect["coefficients"]
    assert only["value"] == pytest.approx(60.0, rel=0.1)
    error = turning.document["error"]
    wanted = (
        "Found: turning",
        f"Turning: {only['value']:.3g} J/rad (95 % interval {only['ci95'][0]:.3g} to {only['ci95'][1]:.3g})",
        f"falls from {100 * error['before']['mean_relative']:.1f}&nbsp;% to",
        step.command,
        "Effects found",
    )
    places = [text.replace("95&nbsp;%", "95 %").index(words) for words in wanted]
    assert places == sorted(places)
    assert "--test-runs" in error_words(turning.document)  # how to judge by runs that had no part in it


def test_test_runs_are_what_the_error_is_stated_of(turning):
    error = turning.document["error"]
    better = {state: values | {"mean_relative": 0.5, "by_run": {"late.csv": 0.5}} for state, values in error.items()}
    better["after"] |= {"mean_relative": 0.25}
    words = error_words(turning.document | {"test_set": {"segments": 90, "error": better}})
    assert words.startswith(
        "On one test run that had no part in the calibration (90 segments of 1 m), the mean relative"
    )
    assert "falls from 50.0 % to 25.0 %" in words
    assert "With what is known before a drive, as in plans, it is 50.0 %" in words
    better["after"] |= {"mean_relative": 0.6}
    assert "does not fall" in error_words(turning.document | {"test_set": {"segments": 90, "error": better}})


def test_what_baseline_runs_show_already_is_not_credited_to_the_effects(turning):
    before = turning.document["error"]["before"]
    sizes = {"before": 0.124, "corrected": 0.107, "after": 0.096, "after_planner": 0.096}
    error = {key: before | {"mean_relative": size, "rmse": 100.0 * size} for key, size in sizes.items()}
    words = error_words(turning.document | {"error": error})
    assert words.startswith("On these runs, each run predicted by a model fitted to the other runs, the mean relative")
    assert "is 12.4 % before; 10.7 % after correcting what the baseline runs show already; 9.6 % with turning" in words
    assert "(root mean square error 12.4, 10.7 and 9.6 J per segment)" in words
    few = {key: values | {"by_run": {"a": 0.1}} for key, values in error.items()}
    assert "each part of a run predicted by a model fitted to the other parts" in error_words(
        turning.document | {"error": few}
    )


def test_without_baseline_runs_nothing_is_said_of_them():
    rng = np.random.default_rng(12)
    drive = made_up(rng)
    found = found_in(drive, noisy(rng, drive, 60.0 * drive.turned_abs_rad))
    informed = replace(found, before=found.before | {"mean_relative": 0.9})  # of a model that is given more than plans
    error = report_document(informed, before=BEFORE, after="2")["error"]
    assert error["corrected"] == error["before"]
    assert "corrected" not in error_states(error)


def test_the_whole_cost_of_turning_in_plans_is_stated(turning):
    def said(total, new, target="energy_j"):
        more = {"turning_in_plans": {"j_per_rad": total, "new_j_per_rad": new}, "target": target}
        return [words for words in found_words(turning.document | more) if words.startswith("In plans")]

    rest = "the rest is in the model already or in what the baseline runs show."
    assert said(73.7, 44.3) == [f"In plans one radian of turning costs 73.7 J: 44.3 J are new, {rest}"]
    assert said(44.3, 44.3) == ["In plans one radian of turning costs 44.3 J."]
    assert said(44.3, 3.7, "charge_as")[0].startswith("In plans one radian of turning costs 44.3 J (charge times")
    assert not [words for words in found_words(turning.document) if words.startswith("In plans")]


def test_a_fitted_curve_is_summed_up_by_its_direction_and_range(turning):
    def said(*values, level=True):
        coefficients = [
            {"name": f"at {v}", "value": v, "unit": "of the motion's energy", "ci95": [v, v]} for v in values
        ]
        settings = {"over": "grade", "knots": [-0.07, 0.0, 0.07], "of": "motion", "level": level}
        (effect,) = turning.document["effects"]
        curve = effect | {"form": "smooth", "coefficients": coefficients, "settings": settings, "where": "everywhere"}
        return found_words(turning.document | {"effects": [curve]})[1]

    end = "of the motion's energy; see the figure in the report. It acts everywhere."
    assert said(-0.704, -0.1, 0.21) == f"A fitted curve over grade, rising from -0.70 to +0.21 {end}"
    assert said(0.3, -0.1, level=False) == f"A fitted curve over grade, falling from +0.30 to -0.10 {end}"
    assert said(0.3, 0.1, level=False) == f"A fitted curve over grade, between +0.00 and +0.30 {end}"


def test_python_prints_the_summary_of_the_command_line(turning, tmp_path):
    result = CalibrationResult(tmp_path, turning.document)
    assert str(result).splitlines() == [*summary_lines(turning.document), f"Report: {tmp_path / 'report.html'}"]
    assert str(result).startswith(
        "Found: turning\nThese runs show one effect that the model made up lacks.\n  Turning:"
    )
    assert repr(result) == "<Calibration: Found: turning>"
    assert error_words(turning.document).split("`")[0] in result._repr_html_()


def test_counts_of_logs_are_said_in_words():
    counts = {"gaps": 1, "stops": 24, "remainders": 34, "bent": 1234, "fast": 0}
    assert left_out_words(counts) == (
        "1 gap, 24 stops, 34 pieces too short for a segment, 1,234 where the path bends too much"
    )
    repairs = {"held_fixes": 2, "voltage_spikes": 1, "current_left_spikes": 3, "blank_current": 5}
    assert repair_words(repairs) == (
        "2 repeated positions, 1 voltage spike, 3 current left spikes, 5 rows without current"
    )


def test_least_p_values_are_bounds(turning):
    assert pytest.approx(1.0 / (SHIFTS + 1)) == LEAST_P
    assert (p_words(0.001), p_words(1e-9), p_words(0.0234)) == ("<= 0.001", "<= 0.001", "= 0.023")
    text = shown(report_page(turning, None))
    assert "&lt;= 0.001" in text or "<= 0.001" in text
    assert "No further candidate effect that is large enough to matter is significant" in text


def test_what_no_log_recorded_is_said_to_be_missing(turning):
    rows = {row["name"]: row for row in turning.document["candidates"]}
    assert rows["wind"]["why_not"].startswith("not recorded; as a constant of the run: ")
    assert not rows["temperature"].get("why_not", "").startswith("not recorded")  # the made-up drive has it


def test_nothing_found_is_said_with_what_could_be_driven(nothing):
    document = nothing.document
    assert headline(document) == "No missing effect was found"
    assert "show no effect that the model made up lacks" in found_words(document)[0]
    assert error_words(document).endswith("No model was written.")
    text = shown(report_page(nothing, None))
    for name, drive in likeliest(document):
        assert f"{name}: {drive}" in text


def test_pages_have_no_private_word(turning, nothing):
    for made in (turning, nothing):
        assert [match[0] for match in PRIVATE.finditer(shown(report_page(made, None)))] == []


def test_every_candidate_has_a_name_and_a_drive_in_plain_words(turning):
    names = [effect_name(candidate.name) for candidate in turning.found.candidates]
    assert len(set(names)) == len(names) > 20
    words = [*names, *(candidate.reveals for candidate in turning.found.candidates)]
    assert [text for text in words if PRIVATE.search(text)] == []


def test_names_of_columns_and_interactions():
    assert effect_name("learned:motor_temperature") == "motor_temperature (fitted curve)"  # as in the log
    assert effect_name("terrain_class:crop") == "class of crop"
    assert effect_name("turning x terrain_class") == "turning by terrain class"
    assert effect_name("new") == "new"
    assert quantity_name("column:rain") == "rain"


def test_a_depth_is_shown_as_a_topographic_position_index():
    """It is positive on a rise and negative below the surroundings (Weiss 2001); the stored depth is the opposite."""
    curve = Term("learned:hollow", "smooth", ("J/m",), {"over": "hollow", "knots": [-0.1, 0.2], "of": "length"}, {})
    assert coefficient_names(curve) == ["at 0.1 m"]
    deep = Term("rolling_resistance", "friction", ("",), {}, {"over": "hollow", "above": 0.05}, (0.03,))
    assert where_words(deep) == "where topographic position index is below -0.05 m"
    east = Term("rolling_resistance", "friction", ("",), {}, {"over": "x", "above": 501044.36}, (0.03,))
    assert where_words(east) == "where x is above 501044.4 m"  # four digits of a UTM coordinate would be 10 m


def test_colour_scales_of_changes_contain_zero_and_do_not_dramatise():
    least = 100.0 * LEAST_SPAN
    assert change_scale(0.1, 0.4, 100.0) == ("Reds", 0.0, least)  # 0.4 of 100 J/m stays pale
    assert change_scale(-0.4, -0.1, 100.0) == ("Blues_r", -least, 0.0)
    assert change_scale(-0.1, 0.4, 100.0) == ("RdBu_r", -least, least)
    assert change_scale(5.8, 46.6, 100.0) == ("Reds", 0.0, 46.6)
    assert change_scale(-20.0, 10.0, 100.0) == ("RdBu_r", -20.0, 20.0)
    assert change_scale(-30.0, -10.0, 100.0) == ("Blues_r", -30.0, 0.0)
    assert change_scale(0.0, 0.0, 0.0)[2] > 0.0


def test_former_keys_are_kept_beside_todays():
    old = with_former_keys({"collinear": [1], "test_set": {"error": 2}, "next_drive": {"confounded_with": ["a"]}})
    assert old["shadows"] == old["collinear"]
    assert old["kept_aside"] == old["test_set"]
    assert old["next_drive"]["tells_from"] == ["a"]
    assert "base_corrections" not in old


def test_a_drive_is_suggested_for_an_effect_by_its_name_or_its_key(nothing):
    class Even:
        def segment_traction(self, heightmap, robot, x, y, heading_rad):
            return np.full(x.shape, 40.0)

    level = Heightmap(np.zeros((120, 120), dtype=np.float32), GridFrame(0.0, 60.0, 0.5, 120, 120))
    for name in ("learned:grade", "grade (fitted curve)"):
        drive = next_drive(nothing.found, Even(), level, ROBOT, effect=name, length_m=40.0)
        assert drive.as_dict()["effect"] == "learned:grade"
    with pytest.raises(InputError, match="no candidate effect 'magic'; the candidate effects are acceleration"):
        next_drive(nothing.found, Even(), level, ROBOT, effect="magic")
    with pytest.raises(InputError, match="name the `effect`"):
        next_drive(nothing.found, Even(), level, ROBOT)
