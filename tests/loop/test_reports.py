"""A thin slice of `tests.loop.reports`: calibrations against baseline runs go through to their files."""

import json

import pytest

from tests.loop import reports


@pytest.mark.parametrize("key", ["heater:0:990641:3:60", "low_mud:1:990298:3:60"])
def test_a_curve_found_against_baseline_runs_is_in_the_report(key):
    """Each of these ended in an error before anything was written."""
    row = reports.try_report(key)
    assert row["lacks"] == []
    assert row["against_baseline"]


def test_what_crashes_or_lacks_anything_is_told(monkeypatch, capsys):
    def crash(*_, **__):
        raise ZeroDivisionError("a figure")

    monkeypatch.setattr("joulemap.service.loop.report_page.error_figure", crash)
    with pytest.raises(SystemExit) as ended:
        reports.main(["--cases", "1", "--effects", "none", "--runs", "2", "--metres", "60"])
    assert ended.value.code == 1
    said = capsys.readouterr().out
    assert "ZeroDivisionError: a figure at test_reports.py:" in said
    assert said.endswith("0 of 1 reports, 0 of them with a curve against the baseline runs.\n")


def test_every_kind_of_effect_has_its_turn():
    keys = reports.keys_of(60, 7, 4, 120.0)
    assert {key.split(":")[0] for key in keys} == set(reports.EVERY)
    assert len(set(keys)) == 60


def test_numbers_that_are_none_are_no_report(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps({"effects": [], "share": float("nan")}))
    with pytest.raises(ValueError, match="has NaN, which is no number"):
        list(reports._lacking(tmp_path, ""))
