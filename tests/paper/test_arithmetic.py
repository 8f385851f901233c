"""The reproduction's arithmetic: intervals, checks, what is planned, and the roughness of a known profile."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.energy.physics import eq5_traction_per_m
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from tests.paper.baselines import local_rolling_resistance
from tests.paper.experiments import EXPERIMENTS
from tests.paper.fieldwork import roughness_m3
from tests.paper.profiles import PROFILES
from tests.paper.runner import plan
from tests.paper.setting import Setting
from tests.paper.summary import Interval, Summary, checks


def test_an_interval_is_students() -> None:
    # Mean 3, standard deviation sqrt(2.5), and t(0.975, 4) = 2.776 from any table of Student's distribution.
    interval = Interval.of([1.0, 2.0, 3.0, 4.0, 5.0])
    assert interval.mean == 3.0
    assert interval.half == pytest.approx(2.776 * math.sqrt(2.5 / 5), rel=1e-3)
    assert Interval.of([0.091]).words() == "9.1 (1 seed)"
    assert Interval.of([0.09, 0.11]).words().startswith("10.0 ± ")


def _result(seed: int, **errors: float) -> dict[str, object]:
    found = {
        method: {"V-A": {"mean_relative_error": error, "route_relative_error": 0.02, "with_turns": error}}
        for method, error in errors.items()
    }
    return {"kind": "compact", "seed": seed, "seconds": 1.0, "methods": found}


def test_checks_compare_methods_seed_by_seed() -> None:
    summary = Summary(
        [_result(1, physics=0.20, compact=0.09, map_floor=0.08), _result(2, physics=0.22, compact=0.10, map_floor=0.08)]
    )
    found = {check.wanted: check for check in checks(summary)}
    gap = next(check for wanted, check in found.items() if "10 points" in wanted)
    assert (gap.found, gap.holds) == ("11.5 points (least seed 11.0)", True)
    floor = next(check for wanted, check in found.items() if "map floor" in wanted)
    assert (floor.found, floor.holds) == ("1.19 (worst seed 1.25)", False)
    paper = next(check for wanted, check in found.items() if "9.1" in wanted)
    assert not paper.holds  # 9.5 %
    assert next(check for wanted, check in found.items() if "routes" in wanted).holds


def test_a_heightmap_from_driven_positions_is_among_the_checks() -> None:
    rows = {"physics_driven": 0.196, "compact_driven": 0.113}
    found = {"kind": "driven", "seed": 1, "methods": {k: {"V-A": {"mean_relative_error": v}} for k, v in rows.items()}}
    gap, paper = checks(Summary([_result(1, physics=0.20, compact=0.08, map_floor=0.08), found]))[-2:]
    assert (gap.found, gap.holds) == ("19.6 % and 11.3 %", False)
    assert gap.wanted.startswith("V-A on a heightmap from driven positions: the error of one fitted friction")
    assert (paper.found, paper.holds) == ("11.3 (1 seed) %", False)


def test_a_plan_has_the_paper_network_once_and_the_backbone_first() -> None:
    setting = Setting(Path("nowhere"), PROFILES["default"])
    tasks = plan(setting)
    kinds = [task.kind for task in tasks]
    assert kinds[0] == "backbone"
    assert kinds.count("resnet_finetuned") == 1
    assert kinds.count("compact") == 5
    assert {task.kind for task in tasks} == {*EXPERIMENTS, "field", "backbone"}
    for task in tasks:
        assert all(tasks.index(need) < tasks.index(task) for need in task.needs)
    assert "backbone" not in {task.kind for task in plan(setting, only=["compact"])}
    with pytest.raises(InputError, match="no experiment 'V-Z'"):
        plan(setting, only=["V-Z"])


def test_roughness_is_that_of_the_profile() -> None:
    """White slopes of density S make a profile of density S / (2 pi n)^2: at 0.1 cycles/m that is 2.533 S."""
    rng = np.random.default_rng(0)
    step, rows = 0.05, 4000
    slopes = 0.1 * rng.standard_normal((rows, 40))  # one-sided density 2 x 0.01 x 0.05 m
    heights = np.cumsum(slopes * step, axis=0).astype(np.float32)
    terrain = Heightmap(heights, GridFrame(0.0, rows * step, step, rows, 40))
    expected = 2 * 0.01 * step / (2 * math.pi * 0.1) ** 2
    assert roughness_m3(terrain) == pytest.approx(expected, rel=0.05)


def test_five_metres_tell_the_next_five():
    mu = np.repeat([0.05, 0.1, 0.15, 0.2], 5)[:18]
    grade = np.linspace(-0.1, 0.1, 18)
    local = local_rolling_resistance(eq5_traction_per_m(200.0, mu, grade), grade, weight_n=200.0)
    assert np.isnan(local[:5]).all()
    np.testing.assert_allclose(local[5:], np.repeat([0.05, 0.1, 0.15], 5)[:13])
