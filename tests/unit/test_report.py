"""What a reader of a calibration's report sees: sentences, names in the field's terms, and honest colour scales."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.forms._base_parameters import PARTS
from joulemap.model.loop.forms.log_faults import MeterLag
from joulemap.model.loop.report import report_document
from joulemap.model.loop.suggest import Suggestion
from joulemap.model.loop.terms import Term
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.library.calibrations import CalibrationResult
from joulemap.service.loop import calibration
from joulemap.service.loop import report_page as page
from joulemap.service.loop.calibration import Calibrated, campaigns_of
from joulemap.service.loop.effect_words import base_name, base_words, confounded_words, found_words
from joulemap.service.loop.next_drive import NextDrive, next_drive
from joulemap.service.loop.report_page import report_page
from joulemap.service.loop.summary import (
    NextStep,
    drive_words,
    error_words,
    headline,
    likeliest,
    plan_words,
    summary_lines,
    with_former_keys,
)
from joulemap.service.words import p_words
from tests.reference.drives import ROBOT, found_in, made_up, noisy
from tests.reference.words import shown

BEFORE = {"name": "made up", "version": "1"}
COVERAGE = {"track_m": 800.0, "used_m": 720.0, "left_out_m": {"gaps": 50.0, "unknown_ground": 30.0}}


def calibrated(measured, rows, **options):
    """A calibration with its report."""
    return documented(found_in(rows, measured, **options))


def documented(found):
    """A calibration with the report that `calibrate_on_runs` makes of it, without a map."""
    document = report_document(found, before=BEFORE, after="2")
    document |= {
        "route": {"why_not": "the runs have no positions"},
        "next_drive": {"why_not": "no route fits"},
        "runs": {
            "names": list(found.residuals.runs),
            "rows": 7200,
            "repairs": {"run0": {"held_fixes": 2}},
            "left_out": {},
            "coverage": COVERAGE,
        },
        "warnings": [],
    }
    return Calibrated(with_former_keys(document), found, None, LEVEL)


def without_figures_of_runs(patch):
    for name in ("prediction_figures", "residual_maps", "against_figures"):
        patch.setattr(page, name, lambda *_: ["<svg></svg>"])


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    """They are drawn in `test_every_form_in_reports.py`."""
    without_figures_of_runs(monkeypatch)


@pytest.fixture(scope="module")
def turning():
    rng = np.random.default_rng(12)
    rows = made_up(rng, runs=4, each=80)
    return calibrated(noisy(rng, rows, 60.0 * rows.turned_abs_rad), rows, cross_validate=True)


@pytest.fixture(scope="module")
def nothing():
    rng = np.random.default_rng(13)
    rows = made_up(rng)
    return calibrated(noisy(rng, rows), rows)


def effect_of(form, name, label, **more):
    return {
        "form": form,
        "name": name,
        "label": label,
        "where": "everywhere",
        "meaning": "energy",
        "settings": {},
        "coefficients": [{"name": name, "value": 60.0, "unit": "J/rad", "ci95": [55.0, 65.0]}],
        "p_value": 1e-5,
        "share_of_residual_variance": 0.6,
        "between_runs": False,
        "in_plans": True,
        "reveals": "circles",
    } | more


def test_the_page_begins_with_what_was_found_how_much_better_it_is_and_what_to_type(turning):
    step = NextStep("Make a cost map with the calibrated model", "joulemap costmap dem.tif --model found/model")
    text = shown(report_page(turning, steps=[step])).replace("&nbsp;", " ")
    effect = turning.document["effects"][0]
    (only,) = effect["coefficients"]
    assert effect["name"] == "turning"
    assert only["value"] == pytest.approx(60.0, rel=0.1)
    error = turning.document["error"]
    wanted = (
        "Found: turning",
        f"Turning: {only['value']:.3g} J/rad (95 % interval {only['ci95'][0]:.3g} to {only['ci95'][1]:.3g}), p ",
        "of the energy is left, cause unknown"
        if turning.document["variation"]["run_share"] >= 5e-4
        else "do not differ",
        f"before {100 * error['before']['mean_relative']:.1f} % mean relative",
        step.command,
        "Base parameters",
        "Effects found",
        "Variation that no effect explains",
        "Prediction error",
        "Track used",
        "Ranges of these runs",
        "What to drive next",
    )
    places = [text.index(words) for words in wanted]
    assert places == sorted(places)


def test_base_parameters_are_declared_and_measured(turning):
    parameters = [
        {"name": "rolling_resistance", "declared": 0.05, "value": 0.0812, "ci95": [0.07, 0.09], "unit": ""},
        {"name": "idle_power_w", "declared": 12.0, "value": 9.5, "ci95": [8.0, 11.0], "unit": "W"},
        {"name": "standing_current", "declared": None, "value": 2.0, "ci95": [1.0, 3.0], "unit": "A"},
        {"name": "measured_slope", "declared": None, "value": 0.0, "ci95": [-2.3, 2.3], "unit": ""},  # no pitch
        {"name": "downhill", "declared": None, "value": 1e-4, "ci95": [1e-4, 1e-4], "unit": "1/V"},  # no descent
    ]
    assert base_words(turning.document | {"base_parameters": parameters}) == [
        "Rolling resistance: 0.05 declared, 0.0812 by the runs (95 % interval 0.07 to 0.09).",
        "Idle power: 12 W declared, 9.5 W by the runs (95 % interval 8 to 11).",
        "Current drawn all the time: 2 A by the runs (95 % interval 1 to 3).",
    ]
    made = Calibrated(turning.document | {"base_parameters": parameters}, turning.found, None, LEVEL)
    text = shown(report_page(made))
    assert "not shown by these runs" in text
    assert text.index("rolling resistance") < text.index("0.0812") < text.index("0.07 to 0.09")
    named = [base_name(name) for name in PARTS]
    assert len(set(named)) == len(PARTS)
    assert [words for words in named if " " not in words] == []  # every parameter has words


SIZES = {"before": 0.124, "corrected": 0.107, "after": 0.096, "after_planner": 0.099, "proposed": 0.099}
SIMPLE = {"least_squares": 0.15, "constant": 0.3}


def errors(sizes):
    states = {
        key: {"mean_relative": size, "rmse": 100.0 * size, "absolute_share": 0.5 * size} for key, size in sizes.items()
    }
    return {key: values | {"bias": 0.0, "by_run": {"late.csv": 0.5}} for key, values in states.items()}


def test_each_state_of_the_model_is_judged_by_three_measures(turning):
    (words,) = error_words(turning.document | {"error": errors(SIZES)})
    assert words == (
        "Errors on runs that had no part in the calibration that predicts them (4 calibrations): "
        "before 12.4 % mean relative, 12.4 J root mean square, 6.2 % of the energy; "
        "with the base parameters 10.7 % mean relative, 10.7 J root mean square, 5.3 % of the energy; "
        "after 9.6 % mean relative, 9.6 J root mean square, 4.8 % of the energy; "
        "after, plan-time prediction 9.9 % mean relative, 9.9 J root mean square, 5.0 % of the energy."
    )


def test_test_runs_come_first(turning):
    better = {"test_set": {"segments": 90, "error": errors(SIZES)}}
    first, second = error_words(turning.document | better)
    assert first.startswith(
        "Errors on one test run that had no part in the calibration (90 segments): before 12.4 % mean relative"
    )
    assert second.startswith("Errors on runs that had no part")


@pytest.mark.parametrize(
    ("sizes", "folds", "test", "confirmed", "in_plans"),
    [
        ({}, 4, None, True, True),
        ({}, 0, None, None, None),
        ({}, 0, {}, True, True),
        ({"after": 0.13}, 4, None, False, True),
        ({"after": 0.13}, 0, None, False, None),
        ({"proposed": 0.13}, 4, None, True, False),
        ({"after": 0.124, "proposed": 0.124}, 4, None, False, False),  # as good is not better
        ({}, 4, {"after": 0.13}, False, True),
        ({}, 4, {"proposed": 0.13}, True, False),
    ],
)
def test_a_model_is_confirmed_where_runs_that_had_no_part_are_predicted_better(
    turning, sizes, folds, test, confirmed, in_plans
):
    judged = {"errors": errors(SIZES | sizes), "test_errors": None if test is None else errors(SIZES | test)}
    document = report_document(replace(turning.found, folds=folds, **judged), before=BEFORE, after="2")
    assert (document["confirmed"], document["confirmed_in_plans"]) == (confirmed, in_plans)


@pytest.mark.parametrize(
    ("state", "said"), [("confirmed", "Not confirmed: "), ("confirmed_in_plans", "Not confirmed for")]
)
def test_a_model_that_is_not_confirmed_is_not_to_be_used(turning, state, said):
    assert "keep the model" not in " ".join(summary_lines(turning.document))
    worse = turning.document | {"error": errors(SIZES | SIMPLE | {"after": 0.2, "proposed": 0.3}), state: False}
    made = Calibrated(worse, turning.found, None, LEVEL)
    assert headline(worse).startswith(f"Found: turning. {said}")
    assert headline(worse).endswith("keep the model that you have.")
    warning = next(line for line in error_words(worse) if line.startswith("WARNING"))
    assert f"({20 if state == 'confirmed' else 30} against 12.4 J root mean square)" in warning
    assert headline(worse) in shown(report_page(made))


@pytest.mark.parametrize(
    ("proposal", "said"),
    [
        ("after_planner", "Plans use the calibrated model (no other prediction surely errs less on routes): 6 J root"),
        (
            "least_squares",
            "Plans use least squares of length, climb, turned angle, time, drag and kinetic energy (errs ",
        ),
        ("before", "Plans use the model before (errs least on routes and runs): 6 J root mean square"),
    ],
)
def test_what_plans_use_is_said_beside_what_it_was_compared_with(turning, proposal, said):
    told = turning.document | {"error": errors(SIZES | SIMPLE | {"proposed": 0.06}), "proposal": proposal}
    first, second = plan_words(told)
    assert first.startswith(said)
    assert ("9.9 J of the calibrated model" in first) == (proposal != "after_planner")
    assert ("12.4 J of the model before" in first) == (proposal != "before")
    assert "30 J of a constant energy per metre" in first
    assert second.startswith("Right on average: the measured energy is ")
    low = {"proposed": {"ratio": 1.2, "std": 0.01, "agrees": False, "factor": 1.2}}
    assert plan_words(told | {"mean": low})[1] == (
        "WARNING: The measured energy is 120.0 % of the predicted one (standard error 1.0 %): all predictions of plans "
        "are multiplied by 1.200."
    )
    few = {"proposed": low["proposed"] | {"factor": 1.0}}
    assert "A factor would make metres worse" in plan_words(told | {"mean": few})[1]
    assert first in shown(report_page(Calibrated(told, turning.found, None, LEVEL))).replace("&nbsp;", " ")


def test_errors_of_the_fit_are_said_to_be_that(nothing):
    """`nothing` is a quick calibration."""
    said = error_words(nothing.document)
    assert said[0].startswith("Errors on the runs that the model was fitted to: before")
    assert said[1].startswith("WARNING: these are errors of the fit")
    html = report_page(nothing)
    assert '<p class="warning">WARNING: these are errors of the fit' in html
    assert "after, fitted to these runs" in html
    assert "left out of the calibration" not in shown(html)


def test_what_was_left_out_is_said(turning):
    def said(**changed):
        validation = turning.document["validation"] | changed
        return error_words(turning.document | {"validation": validation})

    assert said(left_out="campaigns", folds=3)[0].startswith(
        "Errors on campaigns that had no part in the calibration that predicts them (3 calibrations)"
    )
    blocks = said(left_out="blocks", folds=4)
    assert blocks[0].startswith("Errors on blocks that had no part")
    assert blocks[1].startswith("There are too few runs to leave whole ones out")
    assert "after, left out of the calibration" in report_page(turning)


def test_campaigns_are_dates_or_names_before_the_last_underscore():
    assert campaigns_of(["2018-11_00.csv", "2018-11_01.csv", "2019-02_00.csv"]) == ["2018-11", "2018-11", "2019-02"]
    assert campaigns_of(["run_20240301_1.csv", "late-20240301.csv", "x_2024-03-02_a"]) == [
        "20240301",
        "20240301",
        "2024-03-02",
    ]
    assert campaigns_of(["hill", "lawn_1", "lawn_2"]) == ["hill", "lawn", "lawn"]
    with pytest.raises(InputError, match="all 2 runs belong to the campaign 'run'"):
        campaigns_of(["run_1.csv", "run_2.csv"])


def test_the_whole_cost_of_turning_in_plans_is_stated(turning):
    def said(total, new, target="energy_j"):
        more = {"turning_in_plans": {"j_per_rad": total, "new_j_per_rad": new}, "target": target}
        return [words for words in found_words(turning.document | more) if words.startswith("In plans")]

    rest = "the rest is in the model already or in what the baseline runs show."
    assert said(73.7, 44.3) == [f"In plans one radian of turning costs 73.7 J: 44.3 J are new, {rest}"]
    assert said(44.3, 44.3) == ["In plans one radian of turning costs 44.3 J."]
    assert said(44.3, 3.7, "charge_as")[0].startswith("In plans one radian of turning costs 44.3 J (charge times")
    assert not [words for words in found_words(turning.document) if words.startswith("In plans")]


def curve(*values, over="grade", name="learned:grade", label="structure in grade"):
    """Of three knots; the middle one is nil."""
    coefficients = [{"name": "at", "value": v, "unit": "J/m", "ci95": [v - 1.0, v + 1.0]} for v in values]
    settings = {"over": over, "knots": [-0.07, 0.0, 0.07], "of": "length"}
    return effect_of("curve", name, label, coefficients=coefficients, settings=settings)


def test_faults_of_the_log_are_no_part_of_plans(turning):
    late = effect_of("meter_lag", "meter_lag", "late power readings", in_plans=False, where="everywhere")
    drift = effect_of("drift", "drift", "drift over time or distance", in_plans=False)
    document = turning.document | {"effects": [late, drift]}
    assert found_words(document)[1].endswith("It is a fault of the log: plans never contain it.")
    assert found_words(document)[2].endswith("Plans do not contain it: it depends on what only a log records.")
    text = shown(report_page(Calibrated(document, turning.found, None, LEVEL)))
    assert text.index("late power readings") < text.index("no: a fault of the log") < text.index("no: needs a log")


def test_what_cannot_be_distinguished_is_told_with_the_drive_that_would(turning):
    confounded = {
        "confounded": [["turning", "speed", "learned:heading"]],
        "to_separate": {"turning": "circles of several radii at one place"},
    }
    document = turning.document | confounded
    (words,) = confounded_words(document)
    assert words == (
        "These runs cannot distinguish turning from speed or structure in heading. This would: circles of several "
        "radii at one place."
    )
    assert words in summary_lines(document)
    text = shown(report_page(Calibrated(document, turning.found, None, LEVEL)))
    assert "turning, speed, structure in heading" in text


def test_python_prints_the_summary_of_the_command_line(turning, tmp_path):
    result = CalibrationResult(tmp_path, turning.document)
    assert str(result).splitlines() == [*summary_lines(turning.document), f"Report: {tmp_path / 'report.html'}"]
    assert repr(result) == f"<Calibration: {headline(turning.document)}>"
    assert error_words(turning.document)[0] in result._repr_html_()
    assert result.folder == tmp_path / "model"


def test_least_p_values_are_bounds(turning):
    assert (p_words(1e-12), p_words(1e-9), p_words(0.0234)) == ("< 1e-9", "= 1e-09", "= 0.023")
    assert "&lt; 1e-9" in report_page(turning)


def test_nothing_found_is_said_with_what_could_be_driven(nothing):
    document = nothing.document
    assert headline(document) == "No missing effect was found"
    assert "show no effect that the model made up lacks" in found_words(document)[0]
    assert document["model"]["after"] == "2"  # a model is written all the same
    text = shown(report_page(nothing))
    for name, drive in likeliest(document):
        assert f"{name}: {drive}" in text
    near = [c | {"p_value": 0.02} if c["name"] == "speed" else c | {"p_value": 1.0} for c in document["candidates"]]
    assert [name for name, _ in likeliest(document | {"candidates": near})] == ["speed"]
    made = Calibrated(document | {"candidates": near}, nothing.found, None, LEVEL)
    assert "speed: the same line at several speeds" in shown(report_page(made))


LEVEL = Heightmap(np.zeros((120, 120), dtype=np.float32), GridFrame(0.0, 60.0, 0.5, 120, 120))


@pytest.fixture
def suggested(monkeypatch):
    """What is asked of `suggest_drive`: the effect and what is fitted beside it, by label."""
    asked = []

    def suggest(residuals, effect, beside, heightmap, robot, traction, *, length_m, seed):
        asked.append((effect.title, [form.title for form in beside]))
        return Suggestion(np.zeros((2, 2)), "a square", (0.5,), 0.4, 40.0)

    monkeypatch.setattr("joulemap.service.loop.next_drive.suggest_drive", suggest)
    return asked


def drive_for(found, effect=None):
    return next_drive(found, PhysicsPredictor(), LEVEL, ROBOT, effect=effect).as_dict()


@pytest.mark.parametrize(("share", "suggested"), [(0.4, True), (0.95, True), (0.96, False), (1.0, False)])
def test_a_drive_that_would_hardly_narrow_the_interval_is_not_suggested(share, suggested, monkeypatch):
    drive = Suggestion(np.zeros((2, 2)), "a square", (0.5,), share, 40.0)
    found = NextDrive(drive, MeterLag(), (), 200.0, placed=True)
    monkeypatch.setattr(calibration, "next_drive", lambda *_, **__: found)
    answer = calibration._next_drive(None, None, None, SimpleNamespace(robot=ROBOT, placed=True), 0)
    if suggested:
        assert answer["expected_interval_share"] == share
    else:
        assert f"would be {share:.0%} as wide as now" in answer["why_not"]


def test_a_drive_is_suggested_for_an_effect_by_its_name_or_its_label(nothing, suggested):
    for name in ("learned:heading", "structure in heading"):
        drive = drive_for(nothing.found, name)
        assert (drive["effect"], drive["label"]) == ("learned:heading", "structure in heading")
        assert drive["confounded_with"] == drive["confounded_labels"] == []
        assert suggested.pop() == ("structure in heading", [])
    with pytest.raises(InputError, match=r"no candidate effect 'magic'; the candidate effects are .*turning"):
        drive_for(nothing.found, "magic")
    with pytest.raises(InputError, match="no effect was found to measure: name the `effect`"):
        drive_for(nothing.found)


def _with_rivals(found, rivals):
    selection = replace(found.fitted.selection)
    vars(selection)["rivals"] = rivals  # a cached property
    return replace(found, fitted=replace(found.fitted, selection=selection))


def test_without_a_name_the_drive_is_for_what_cannot_be_distinguished_or_is_least_certain(turning, suggested):
    fitted = replace(turning.found.fitted, effects=turning.found.fitted.effects[:1])  # of turning
    alike = _with_rivals(replace(turning.found, fitted=fitted), {"turning": ["speed", "learned:heading"]})
    drive = drive_for(alike)
    assert (drive["label"], drive["confounded_labels"]) == ("turning", ["speed", "structure in heading"])
    assert suggested.pop() == ("turning", ["speed", "structure in heading"])
    assert drive_words(drive | {"points": [[0.0, 0.0], [1.0, 1.0]]}).endswith(
        "to distinguish turning from speed or structure in heading. The 95 % interval of its coefficient is then "
        "expected to be 40 % as wide as now."
    )
    other = drive_for(alike, "speed")
    assert (other["label"], other["confounded_with"]) == ("speed", ["turning"])
    clear = drive_for(_with_rivals(alike, {}))
    assert (clear["label"], clear["confounded_labels"]) == ("turning", [])
    assert "to measure turning more precisely" in drive_words(clear)
    late = replace(fitted.effects[0], term=Term(MeterLag(), (1.0,)))
    with pytest.raises(InputError, match="no effect was found that a route can show"):
        drive_for(_with_rivals(replace(alike, fitted=replace(fitted, effects=(late,))), {}))
