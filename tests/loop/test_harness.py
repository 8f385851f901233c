"""The harness with calibrators whose answers are known: one finds nothing, one is given the truth."""

import dataclasses
import math

import pytest

from joulemap.model.field.validation_case import CaseTruth, Coefficient
from tests.loop.calibrators import Nothing, Oracle
from tests.loop.cases import Outcome, append_outcome, fits_of, read_outcomes, try_case
from tests.loop.table import table_of

FOUND = Outcome(
    case="turning",
    seed=3,
    true=("turning",),
    found=("turning",),
    new_before=0.2,
    new_after=0.1,
    new_clean=0.1,
    other_before=0.25,
    other_after=0.13,
    other_informed=0.1,
    other_clean=0.11,
    floor=0.06,
    tried_s=4.0,
)


def test_an_outcome_is_judged_by_its_names():
    assert FOUND.first_right
    assert FOUND.all_right
    assert FOUND.gain_share == pytest.approx(0.12 / 0.15)
    second = dataclasses.replace(FOUND, found=("speed", "turning"))
    assert not second.first_right
    assert second.all_right
    assert second.false_finds == ("speed",)
    quiet = dataclasses.replace(FOUND, true=(), found=())
    assert quiet.first_right
    assert not dataclasses.replace(quiet, found=("wind",)).first_right
    pair = dataclasses.replace(FOUND, true=("turning", "wind"))
    assert pair.first_right
    assert not pair.all_right
    place = dataclasses.replace(FOUND, true=("local_friction",), found=("learned:place",))
    assert place.first_right
    assert dataclasses.replace(FOUND, other_informed=0.245).gain_share is None
    assert dataclasses.replace(FOUND, knowable=False).gain_share is None


def test_outcomes_are_kept_as_they_are(tmp_path):
    kept = tmp_path / "outcomes.jsonl"
    assert read_outcomes(kept) == []
    append_outcome(kept, FOUND)
    append_outcome(kept, dataclasses.replace(FOUND, seed=4))
    assert read_outcomes(kept) == [FOUND, dataclasses.replace(FOUND, seed=4)]


def test_coefficients_are_compared_where_effect_and_unit_agree():
    truth = CaseTruth(
        0, 0, (), (Coefficient("turning", 100.0, "J/rad"), Coefficient("drift", 2.0, "J/m/h")), {}, {}, {}
    )
    stated = {"name": "turning", "value": 90.0, "unit": "J/rad", "ci95": [80.0, 95.0]}
    report = {
        "effects": [
            {"name": "turning", "coefficients": [stated]},
            {"name": "drift", "coefficients": [{"name": "drift", "value": 0.1, "unit": "1/h", "ci95": [0.0, 0.2]}]},
        ]
    }
    (fit,) = fits_of(report, truth)
    assert (fit.effect, fit.true, fit.value, fit.low, fit.high) == ("turning", 100.0, 90.0, 80.0, 95.0)
    assert "| 10% | 0/1 |" in table_of([dataclasses.replace(FOUND, fits=(fit,))])


@pytest.mark.slow
def test_an_oracle_gains_everything_and_one_that_finds_nothing_gains_nothing(tmp_path):
    informed = try_case("turning", 0, Oracle(), tmp_path)
    assert informed.first_right
    assert informed.gain_share == pytest.approx(1.0)
    assert informed.new_after < 0.8 * informed.new_before
    assert all(fit.low <= fit.true <= fit.high for fit in informed.fits)
    assert math.isclose(informed.other_after, informed.other_informed)
    nothing = try_case("turning", 0, Nothing(), tmp_path)
    assert not nothing.first_right
    assert nothing.gain_share == 0.0
    assert nothing.new_before == informed.new_before
    assert not any((tmp_path / "cases").iterdir())
