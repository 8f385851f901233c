"""A thin slice of `tests.loop.reports`: calibrations against baseline runs go through to their files."""

from tests.loop import reports


def test_a_curve_found_against_baseline_runs_is_in_the_report():
    """This ended in an error before anything was written; so did the case of `tests/service/test_found_in_runs.py`."""
    row = reports.try_report("heater:0:990641:3:60")
    assert row["lacks"] == []
    assert row["against_baseline"]
