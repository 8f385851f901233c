"""What a reader of a calibration's report sees: sentences, names in the field's terms, and honest colour scales."""

import numpy as np
import pytest

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.effects import Term
from joulemap.model.loop.report import coefficient_names, report_document, where_words
from joulemap.model.loop.words import effect_name, quantity_name
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.calibration import Calibrated
from joulemap.service.loop.deprecated_keys import with_former_keys
from joulemap.service.loop.next_drive import next_drive
from joulemap.service.loop.report_figures import LEAST_SPAN, change_scale
from joulemap.service.loop.report_page import report_page
from joulemap.service.loop.summary import NextStep, error_words, found_words, headline, likeliest
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
