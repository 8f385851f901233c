"""The OpenAPI document is up to date, and the service keeps to it whatever is sent."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import httpx
import schemathesis
import uvicorn
from fastapi import FastAPI
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
    unsupported_method,
)

from joulemap.model.robot import Robot
from joulemap.planner.route_planner import SAMPLING_PLANNERS
from joulemap.service.http.app import create_app, openapi_document
from joulemap.service.schemas.base import RobotIn, RobotOut
from tests.service.api_digest import FOLDER, kept
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_calibrations import run_csv

_EXAMPLES = 2  # of an operation, with and against the document each
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
    response_headers_conformance,
    unsupported_method,
]


def test_document_is_up_to_date() -> None:
    """The hash and the list of operations in the repository are those of the document."""
    document = openapi_document()
    for name, text in kept(document).items():
        assert (FOLDER / name).read_text(encoding="utf-8") == text, f"openapi/{name} is stale: make openapi"
    assert document["openapi"].startswith("3.1")


def test_every_field_is_described() -> None:
    """Units are given in descriptions, so none may be missing, except where the name says everything."""
    plain = {"id", "status", "links", "total", "items", "rows", "cols", "crs", "type", "title", "detail", "code"}
    plain |= {"name", "version", "planners", "created_at", "heightmap_id", "request_id", "feasible", "hash", "planner"}
    plain |= {"start", "goal", "path", "profile", "shortest", "warnings", "out", "frame", "blocked", "robot", "free"}
    for name, schema in openapi_document()["components"]["schemas"].items():
        for key, value in schema.get("properties", {}).items():
            assert key in plain or "description" in value or "$ref" in value, f"{name}.{key}"


def test_robot_schema_is_the_robot() -> None:
    names = [f.name for f in fields(Robot)]
    assert list(RobotIn.model_fields) == names
    assert list(RobotOut.model_fields) == names


@contextmanager
def served(app: FastAPI) -> Iterator[str]:
    """The app behind a real server in this process; its base URL."""
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="warning", loop="asyncio"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive(), "the server did not start"
        time.sleep(0.02)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(30.0)


def test_nothing_sent_breaks_the_service(tmp_path: Path, hill_tif: bytes) -> None:
    """Requests generated from the document, about half of them deliberately against it, on a map that exists.

    Many thousands, with all checks of Schemathesis: `python -m tests.fuzz.contract`.
    """
    app = create_app(settings_for(tmp_path, max_cells=100_000, max_lattice_values=200_000, queue_size=1000))
    seen: dict[str, Counter[int]] = {}
    with served(app) as url:
        heightmap = httpx.post(f"{url}/v1/heightmaps", content=hill_tif, timeout=60).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        made = httpx.post(f"{url}/v1/costmaps", json=asked, headers={"Prefer": "wait=60"}, timeout=70)
        runs = httpx.post(f"{url}/v1/runs", content=run_csv(0, metres=30.0), timeout=200).json()["id"]
        calibration = httpx.post(f"{url}/v1/calibrations", json={**asked, "runs": [runs]}, timeout=60).json()["id"]
        known = {"costmap_id": made.json()["id"], "heightmap_id": heightmap, "runs_id": runs}
        known["calibration_id"] = calibration
        for found in schemathesis.openapi.from_url(f"{url}/openapi.json").get_all_operations():
            operation = found.ok()
            if operation.method == "delete":
                continue
            for mode in GenerationMode:
                run_cases(operation, mode, known, seen.setdefault(f"{operation.method} {operation.path}", Counter()))
    assert {200, 422} <= set(seen["post /v1/costmaps/{costmap_id}/paths"])
    assert {200, 422} <= set(seen["post /v1/costmaps/{costmap_id}/feasibility"])
    assert {200, 422} <= set(seen["post /v1/costmaps/{costmap_id}/tours"])
    assert {202, 422} <= set(seen["post /v1/costmaps"])
    assert {200, 422} <= set(seen["get /v1/costmaps/{costmap_id}/at"])
    assert {422} <= set(seen["post /v1/runs"])
    assert {202, 422} <= set(seen["post /v1/calibrations"])
    assert {409} <= set(seen["get /v1/calibrations/{calibration_id}/report.html"])


def run_cases(
    operation: Any,
    mode: GenerationMode,
    known: dict[str, str],
    seen: Counter[int],
) -> None:
    @settings(
        max_examples=_EXAMPLES,
        deadline=None,
        database=None,
        derandomize=True,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def ask(case: Any) -> None:
        parameters = case.path_parameters or {}
        parameters.update({key: value for key, value in known.items() if key in parameters})
        query = case.query or {}
        if all(isinstance(query.get(key), float | int) for key in "xy"):
            query.update(x=START[0], y=START[1])
        if mode.is_positive and operation.path.endswith("/at"):
            case.query = {"x": START[0], "y": START[1]}
        if isinstance(case.body, dict):
            if mode.is_positive and operation.path.endswith("/calibrations"):
                case.body.update(heightmap_id=known["heightmap_id"])  # the runs that are known have positions
            point_towards_the_map(case.body, known)
            if mode.is_positive and operation.path.endswith(("/paths", "/feasibility")):
                case.body.update(start=START, goal=GOAL)
                case.body.pop("path", None)
                case.body.pop("robot", None)
            if mode.is_positive and operation.path.endswith("/tours"):
                case.body.update(stops=[START, GOAL])
                case.body.pop("robot", None)
        answer = case.call(timeout=60)
        case.validate_response(answer, checks=CHECKS)
        seen[answer.status_code] += 1

    with suppress(Unsatisfiable):  # what takes no input cannot be asked wrongly
        ask()


def point_towards_the_map(body: dict[str, Any], known: dict[str, str]) -> None:
    """Random places are nearly always outside: put the well-formed ones on the map. Time limits stay short."""
    for key in ("runs", "baseline_runs", "test_runs"):
        if isinstance(body.get(key), list) and body[key] and all(isinstance(v, str) for v in body[key]):
            body[key] = [known["runs_id"]]
    if isinstance(body.get("heightmap_id"), str):
        body["heightmap_id"] = known["heightmap_id"]
        if isinstance(body.get("model", ""), str):
            body["model"] = "physics"
        if isinstance(body.get("spacing_m"), float | int):
            body["spacing_m"] = min(body["spacing_m"], 5.0)
    for key, place in (("start", START), ("goal", GOAL)):
        if isinstance(body.get(key), list) and all(isinstance(v, float | int) for v in body[key]):
            body[key] = place
    if isinstance(body.get("time_limit_s"), float | int):
        body["time_limit_s"] = min(body["time_limit_s"], 0.1)
    elif body.get("planner") in SAMPLING_PLANNERS and "time_limit_s" not in body:
        body["time_limit_s"] = 0.1
