"""A value that is out of bounds is refused in the same words by Python, by the client and by HTTP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import joulemap as jm
from joulemap.model.errors import InputError
from tests.service.conftest import GOAL, START
from tests.service.test_cli import joulemap
from tests.service.test_client import client, costmap, local, running

__all__ = ["client", "costmap", "local", "running"]
FAR = [2e9, 0.0]
ENDS = {"start": START, "goal": GOAL}


@pytest.mark.parametrize(
    ("question", "body", "said", "ask"),
    [
        ("paths", ENDS | {"quantile": 0.999}, ("quantile", "0.999", "0.99"), lambda m, b: m.plan(**b)),
        ("paths", ENDS | {"time_limit_s": 61.0}, ("time_limit_s", "61", "60"), lambda m, b: m.plan(**b)),
        ("paths", ENDS | {"alternatives": 11}, ("alternatives", "11", "10"), lambda m, b: m.plan(**b)),
        ("paths", ENDS | {"neighbours": 4}, ("neighbours", "4", "8, 16 or 32"), lambda m, b: m.plan(**b)),
        ("paths", ENDS | {"goal": "there"}, ("goal", "there"), lambda m, b: m.plan(**b)),
        ("paths", ENDS | {"battery": {"health": 0.01}}, ("battery.health", "0.01", "0.05"), lambda m, b: m.plan(**b)),
        ("tours", {"stops": [START, FAR]}, ("stops.1", "2000000000"), lambda m, b: m.tour(**b)),
        ("reach", {"start": START, "confidence": 0.3}, ("confidence", "0.3", "0.5"), lambda m, b: m.reach(**b)),
        (
            "return",
            {"position": START, "home": GOAL, "battery": {"charge": 60}},
            ("battery.charge", "write 0.6"),
            lambda m, b: m.homeward(**b),
        ),
    ],
)
def test_bounds_are_said_alike(
    costmap: Any,
    local: jm.CostMap,
    question: str,
    body: dict[str, Any],
    said: tuple[str, ...],
    ask: Callable[[Any, dict[str, Any]], Any],
) -> None:
    with pytest.raises(InputError) as sent:
        costmap._connection.send("POST", f"/v1/costmaps/{costmap.id}/{question}", json=body)
    for asked in (local, costmap):
        with pytest.raises(InputError) as here:
            ask(asked, body)
        assert here.value.message == sent.value.message
    assert all(part in sent.value.message for part in said)


@pytest.mark.parametrize(
    ("option", "field", "value"),
    [
        ("--quantile", "quantile", 0.999),
        ("--time-limit", "time_limit_s", 61.0),
        ("--seed", "seed", -1),
    ],
)
def test_a_command_says_the_same_of_its_option(
    costmap: Any, local: jm.CostMap, tmp_path: Path, option: str, field: str, value: float
) -> None:
    folder = local.save(tmp_path / "map.zarr")
    ends = [f"--start={START[0]},{START[1]}", f"--goal={GOAL[0]},{GOAL[1]}"]
    more = ["--objective", "quantile"] if field == "quantile" else []
    code, _, words = joulemap("path", folder, *ends, *more, f"{option}={value}")
    with pytest.raises(InputError) as sent:
        costmap._connection.send("POST", f"/v1/costmaps/{costmap.id}/paths", json=ENDS | {field: value})
    assert code == 2
    assert sent.value.message.replace(f"{field}:", f"{option}:") in " ".join(words.split())


def test_what_the_battery_says_is_not_said_otherwise(costmap: Any, local: jm.CostMap) -> None:
    pack, route = jm.Battery(280.0, charge=0.8), local.plan(START, GOAL)
    with pytest.raises(InputError, match=r"`charge` is 0\.5, and `battery` says 0\.8: say it once"):
        local.feasibility(route, battery=pack, charge=0.5)
    with pytest.raises(InputError, match="`charge` is "):
        costmap.feasibility([START, GOAL], battery=pack, charge=0.5)
    with pytest.raises(InputError, match=r"`reserve` is 0\.2"):
        local.reach(START, battery=pack, reserve=0.2)
    assert local.reach(START, battery=pack).charges == (0.8,)
    assert local.reach(START, battery=pack, charge=[0.4, 0.6]).charges == (0.4, 0.6)
    course = local.feasibility(route, battery={"health": 0.5}, charge=0.8).verdict
    assert course.available_j == pytest.approx(0.5 * local.feasibility(route, charge=0.8).verdict.available_j)


def test_a_long_way_and_polygons_are_taken(local: jm.CostMap, costmap: Any) -> None:
    """How many points there may be is left to a service that many share; the client takes polygons too."""
    shapely = pytest.importorskip("shapely.geometry")
    way = [START, GOAL] * 50_001
    assert local.homeward(START, START, path=way, confidence=None).length_m > 1e6
    area = shapely.box(START[0] + 8.0, START[1] - 4.0, START[0] + 12.0, START[1] + 4.0)
    assert costmap.plan(START, GOAL, avoid=area).energy_j == pytest.approx(
        local.plan(START, GOAL, avoid=[area]).energy_j, rel=1e-9
    )
