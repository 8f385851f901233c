"""A robot's own computer: planner and filter run without what only a service or a training needs."""

from __future__ import annotations

from pathlib import Path

from tests.bench.on_robot import HEAVY, on_one_core, saved_map


def test_a_saved_map_is_planned_on_and_a_drive_is_followed_without_torch_fastapi_and_dask(tmp_path: Path) -> None:
    found = on_one_core(saved_map(tmp_path, 80), (10.0, 40.0), (70.0, 42.0))
    assert found["learnt_m"] > 20.0
    assert not {name.partition(".")[0] for name in found["modules"]} & set(HEAVY)
    assert [step for step, *_ in found["steps"]][-1] == "100 updates with forecast"
