"""A thin slice of `tests.loop.reports`: calibrations against baseline runs go through to their files."""

import pytest

from tests.loop import reports


@pytest.mark.parametrize("key", ["heater:0:990641:3:60", "low_mud:1:990298:3:60"])
def test_a_curve_found_against_baseline_runs_is_in_the_report(key):
    """Each of these ended in an error before anything was written."""
    row = reports.try_report(key)
    assert row["lacks"] == []
    assert row["against_baseline"]
