"""A path of very many points: checked as an array, with the same outcome as one by one."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from pydantic import ValidationError

from joulemap.service.http.asked import answer_of
from joulemap.service.http.quick_json import parsed
from joulemap.service.questions.feasibility import FeasibilityRequest
from tests.service.conftest import GOAL, START

MANY = [[500_000.0 + k, 4_000_000 + k] for k in range(1_500)]


def outcome(points: list[Any]) -> Any:
    """The last point as it is understood; None where the path is refused."""
    try:
        path = FeasibilityRequest(path=points).path
    except ValidationError:
        return None
    assert path is not None
    return list(path[-1])


@pytest.mark.parametrize(
    "last",
    [
        [1, 2],
        [1.5, 2.5, 3.5],
        [1, 2, None],
        [1],
        [1, 2, 3, 4],
        [1, None],
        ["1", "2"],
        ["one", 2],
        [True, 2],
        [0, 1],
        [2, False, 5.0],
        [1e300, 2],
        [float("nan"), 2],
        [float("inf"), 2],
        [10**30, 2],
        [[1], 2],
        {"x": 1, "y": 2},
        "12",
        None,
        7,
    ],
)
def test_many_points_are_checked_as_few_are(last: Any) -> None:
    assert outcome([*MANY, last]) == outcome([*MANY[:5], last])


def test_a_long_path_over_http_has_the_verdict_of_a_short_one(client: TestClient, costmap_id: str) -> None:
    """Whether it is parsed quickly or not."""
    url = f"/v1/costmaps/{costmap_id}/feasibility"
    few = client.post(url, json={"path": [START, GOAL]}).json()
    ends = np.array([START, GOAL])
    many = (ends[0] + np.linspace(0.0, 1.0, 20_000)[:, None] * (ends[1] - ends[0])).tolist()
    answer = client.post(url, json={"path": many})
    assert answer.status_code == 200, answer.text
    assert answer.json()["feasible"] == few["feasible"]
    assert answer.json()["energy_j"] == pytest.approx(few["energy_j"], rel=1e-3)


POINTS = [[k * 1.5, k] for k in range(40_000)]


@pytest.mark.parametrize(
    "value",
    [
        {"path": POINTS, "battery": {"charge": 0.5}},
        {"s": "[[1,2]]", "path": POINTS},
        {"path": POINTS, "again": POINTS},
        {"within": {"path": POINTS}},
        {"path": [*POINTS, [1, [2, 3]]]},
        {"path": [*POINTS, []]},
        {"areas": [POINTS, POINTS]},
        POINTS,
    ],
    ids=range(8),
)
@pytest.mark.parametrize("indent", [None, 0])
def test_what_is_parsed_in_slices_is_what_is_parsed_at_once(value: Any, indent: int | None) -> None:
    assert parsed(json.dumps(value, indent=indent).encode()) == value


@pytest.mark.parametrize(
    ("sent", "meant"), [("]}", "]"), ("5999", "59 99"), ("[1.5, 1]", "[1.5, 1],"), ("]}", '], "é": x}'), ("{", "[")]
)
def test_a_large_body_that_is_no_json_is_refused_with_its_place(
    client: TestClient, costmap_id: str, sent: str, meant: str
) -> None:
    body = json.dumps({"path": POINTS}).replace(sent, meant, 1)
    with pytest.raises(json.JSONDecodeError) as found:
        json.loads(body)
    answer = client.post(
        f"/v1/costmaps/{costmap_id}/feasibility", content=body.encode(), headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 422
    assert f"at character {found.value.pos}" in answer.text


def test_a_wrong_field_of_a_large_body_is_named_as_in_a_small_one(client: TestClient, costmap_id: str) -> None:
    url = f"/v1/costmaps/{costmap_id}/feasibility"
    few, many = (client.post(url, json={"path": POINTS[:n], "batery": {}}) for n in (3, 40_000))
    assert (few.status_code, many.status_code) == (422, 422)
    assert few.json()["detail"] == many.json()["detail"]
    assert few.json()["context"] == many.json()["context"]


def test_a_long_answer_is_written_in_slices() -> None:
    values = {"a": {"b": [[0.5, float("nan"), None]] * 9_001, "é": []}, "c": ["x,]"] * 4_000, "d": 1}
    assert json.loads(answer_of(values).body) == json.loads(json.dumps(values).replace("NaN", "null"))
