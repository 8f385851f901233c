"""The one table of errors: every leaf has a status and an exit code, and bodies are JSON whatever the context holds."""

from __future__ import annotations

import json

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from joulemap.model import errors
from joulemap.service import problems
from joulemap.service.http import problem_answers
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.middleware import RequestLimits
from joulemap.service.http.observed import Observed


def tree(cls: type[errors.JoulemapError]) -> list[type[errors.JoulemapError]]:
    return [found for child in cls.__subclasses__() for found in (child, *tree(child))]


def test_every_error_has_a_status_and_an_exit_code() -> None:
    classes = [cls for cls in tree(errors.JoulemapError) if cls.__module__ == "joulemap.model.errors"]
    assert len(classes) >= 14
    for cls in classes:
        row = problems.row_of(cls)
        assert row is not None, f"{cls.__name__} has no row in service.problems.TABLE"
        assert problems.exit_code(cls("x")) == row.exit_code
        assert problems.problem_of(cls("words", limit=1))["status"] == row.status
    assert len({row.exit_code for row in problems.TABLE.values()}) == len(problems.TABLE)
    assert {2, 0} & {row.exit_code for row in problems.TABLE.values()} == set()


def test_statuses_are_those_of_the_architecture() -> None:
    expected = {
        errors.HeightmapError: 422,
        errors.BlockedError: 422,
        errors.NotFoundError: 404,
        errors.ConflictError: 409,
        errors.TooLargeError: 413,
        errors.BusyError: 503,
    }
    assert {cls: problems.problem_of(cls("x"))["status"] for cls in expected} == expected
    assert problems.problem_of(ValueError("secret"))["status"] == 500
    assert "secret" not in json.dumps(problems.problem_of(ValueError("secret")))
    assert problems.exit_code(ValueError("bug")) == 1


def test_any_context_becomes_json() -> None:
    context = {
        "nan": float("nan"),
        "array": np.arange(3.0),
        "scalar": np.float32(1.5),
        "bytes": b"\xff",
        "object": object(),
        "long": "x" * 10_000,
        "many": list(range(1000)),
        "surrogate": "\ud800",
        "nested": {"inf": [float("inf")]},
    }
    body = problems.problem_of(errors.InputError("words", **context))
    text = json.dumps(body, allow_nan=False)
    assert len(text) < 3000
    text.encode("utf-8")
    assert body["context"]["nan"] == "nan"
    assert body["context"]["array"] == [0.0, 1.0, 2.0]


@pytest.fixture
def faulty() -> TestClient:
    app = FastAPI()
    problem_answers.install(app)
    app.add_middleware(RequestLimits, upload_bytes=10, other_bytes=10, upload_paths=())
    app.add_middleware(Observed, metrics=Metrics())

    @app.get("/bug")
    def bug() -> None:
        raise ZeroDivisionError("a detail for the log only")

    @app.get("/busy")
    def busy() -> None:
        raise errors.BusyError("full", retry_after_s=7)

    return TestClient(app, raise_server_exceptions=False)


def test_our_own_bug_tells_only_its_request_id(faulty: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    answer = faulty.get("/bug", headers={"X-Request-ID": "abc-1"})
    assert (answer.status_code, answer.json()["request_id"], answer.headers["x-request-id"]) == (500, "abc-1", "abc-1")
    assert "log only" not in answer.text
    assert "abc-1" in caplog.text
    assert "ZeroDivisionError" in caplog.text


def test_busy_says_when_to_come_back(faulty: TestClient) -> None:
    answer = faulty.get("/busy", headers={"X-Request-ID": "bad id\n"})
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "7")
    assert answer.json()["request_id"] != "bad id\n"
