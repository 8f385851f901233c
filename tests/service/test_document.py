"""The OpenAPI document says everything: statuses, problems, examples, fields that go together, keys, and methods."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
from fastapi.testclient import TestClient
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from joulemap.service.http.app import create_app, openapi_document
from joulemap.service.http.documents import TOGETHER, recorded_examples
from joulemap.service.questions.feasibility import FeasibilityRequest
from joulemap.service.storage.owners import add_key
from tests.service.conftest import GOAL, START, settings_for
from tests.service.record_examples import record

DOCUMENT = openapi_document()
OPERATIONS = [
    pytest.param(path, method, operation, id=operation["operationId"])
    for path, methods in DOCUMENT["paths"].items()
    for method, operation in methods.items()
]
PROBLEM = "application/problem+json"


def validator(schema: dict[str, Any]) -> Any:
    """Of a schema of the document, with what it refers to."""
    text = json.dumps({**schema, "components": DOCUMENT["components"]})
    return jsonschema_rs.Draft202012Validator(json.loads(text))


@pytest.mark.parametrize(("path", "method", "operation"), OPERATIONS)
def test_every_status_has_a_body_and_an_example(path: str, method: str, operation: dict[str, Any]) -> None:
    statuses = {int(status) for status in operation["responses"]}
    if path.startswith("/v1"):
        assert {401, 403, 429, 500, 503} <= statuses
        assert "security" in operation
    if "{" in path:
        assert 404 in statuses
    if method == "post" and path.count("/") == 2:
        assert 507 in statuses
    for status, response in operation["responses"].items():
        if int(status) >= 400:
            content = response["content"][PROBLEM]
            assert content["example"]["status"] == int(status)
            validator(content["schema"]).validate(content["example"])
            assert not content["example"]["code"].startswith("internal") or status == "500"
        if int(status) in (429, 503):
            assert "Retry-After" in response["headers"]
        for kind, content in response.get("content", {}).items():
            if kind.endswith("json"):
                assert "example" in content, (status, kind)
                validator(content["schema"]).validate(content["example"])


@pytest.mark.parametrize(("path", "method", "operation"), OPERATIONS)
def test_every_question_has_an_example(path: str, method: str, operation: dict[str, Any]) -> None:
    for parameter in operation.get("parameters", []):
        schema = parameter["schema"]
        shown = [parameter["example"]] if "example" in parameter else schema.get("examples", [])
        assert shown or "default" in schema or "anyOf" in schema, parameter["name"]
        for example in shown:
            validator(schema).validate(example)
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        if kind == "application/json":
            validator(content["schema"]).validate(content["example"])


def test_the_examples_are_what_a_service_answers(tmp_path: Path) -> None:
    """Every operation is asked again as in its example: the same statuses, and the same fields."""
    with TestClient(create_app(settings_for(tmp_path)), base_url="http://localhost") as client:
        now = record(client)
    before = recorded_examples()
    assert now.keys() == before.keys() == {operation.values[2]["operationId"] for operation in OPERATIONS}
    for name in before:
        for key in ("parameters", "body"):
            assert now[name].get(key) == before[name].get(key), f"{name}: python -m tests.service.record_examples"
        assert fields_of(now[name]["answers"]) == fields_of(before[name]["answers"]), name


def fields_of(value: Any, place: str = "") -> set[str]:
    """All keys in a document, with their place; those of free objects (reports, details) are not compared."""
    if isinstance(value, dict):
        free = place.endswith((".checks", ".details", ".provenance", ".report"))
        return {place} if free else {place}.union(*(fields_of(v, f"{place}.{k}") for k, v in value.items()))
    if isinstance(value, list):
        return {place}.union(*(fields_of(item, f"{place}[]") for item in value))
    return {place} if value is not None else set()


def test_405_names_all_methods(client: TestClient) -> None:
    ids = {"heightmap_id": "hm-1", "costmap_id": "cm-1", "runs_id": "runs-1", "calibration_id": "cal-1"} | {
        "drive_id": "dr-1"
    }
    for path, methods in DOCUMENT["paths"].items():
        url = re.sub(r"{(\w+)}", lambda found: ids[found[1]], path)
        for method in {"get", "post", "put", "patch", "delete", "options"} - methods.keys():
            answer = client.request(method, url)
            assert answer.status_code == 405, (method, path)
            assert {name.strip().lower() for name in answer.headers["allow"].split(",")} == methods.keys(), path
    assert client.post("/").headers["allow"] == "GET"


POINTS = st.sampled_from([None, START, GOAL, [1.0], "x"])


def outcomes(schema: dict[str, Any], model: Any, body: dict[str, Any]) -> Iterator[bool]:
    yield validator(schema).is_valid(body)
    try:
        TypeAdapter(model).validate_python(body)
        yield True
    except ValidationError:
        yield False


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    body=st.dictionaries(
        st.sampled_from(["path", "start", "goal"]),
        st.one_of(POINTS, st.just([START, GOAL]), st.just([START])),
        max_size=3,
    )
)
def test_what_the_schema_says_of_a_task_is_what_the_service_does(body: dict[str, Any]) -> None:
    schema = {"$ref": "#/components/schemas/FeasibilityRequest"}
    by_schema, by_service = outcomes(schema, FeasibilityRequest, body)
    assert by_schema == by_service, body


def test_parameters_that_go_together(client: TestClient, costmap_id: str) -> None:
    """Each one alone is refused, as the document says."""
    values = {"within": 5.0, "terrain_from_name": True}
    for (name, parameter), needed in TOGETHER.items():
        path, method, operation = next(one.values for one in OPERATIONS if one.values[2]["operationId"] == name)
        said = next(one for one in operation["parameters"] if one["name"] == parameter)
        assert said["x-requires"] == list(needed)
        assert all(f"`{other}`" in said["description"] for other in needed)
        url = path.replace("{costmap_id}", costmap_id)
        answer = client.request(method, url, params={parameter: values.get(parameter, START[0])}, content=b"t,x\n")
        assert answer.status_code == 422, (name, parameter, answer.text)


def test_states_of_a_job_in_the_schema() -> None:
    """A cost map that is done without a frame, or failed without a problem, is against the schema."""
    done = recorded_examples()["get_costmap"]["answers"]["200"]["application/json"]
    schema = validator({"$ref": "#/components/schemas/CostmapOut"})
    schema.validate(done)
    waiting = {**done, "status": "queued", "finished_at": None, "frame": None, "blocked": None, "provenance": None}
    schema.validate(waiting)
    for wrong in (
        {**done, "frame": None},
        {**done, "finished_at": None},
        {**done, "status": "failed"},
        {**waiting, "status": "failed"},
        {**waiting, "finished_at": done["finished_at"]},
    ):
        assert not schema.is_valid(wrong)


def test_metrics_and_the_document_with_keys(tmp_path: Path) -> None:
    with TestClient(create_app(settings_for(tmp_path, workers=0))) as client:
        sessions = client.app.state.service.store.sessions  # type: ignore[attr-defined]
        keys = {name: add_key(sessions, name, operator=name == "operator") for name in ("anna", "operator")}
        statuses = {name: client.get("/metrics", headers={"X-API-Key": key}).status_code for name, key in keys.items()}
        assert statuses == {"anna": 403, "operator": 200}
        assert client.get("/metrics").status_code == 401
        assert client.get("/openapi.json").json() == DOCUMENT
        schemes = DOCUMENT["components"]["securitySchemes"]
        assert {scheme["type"] for scheme in schemes.values()} == {"http", "apiKey"}
