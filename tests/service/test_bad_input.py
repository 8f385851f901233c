"""Bad input gets a clear problem body, and nothing is lost or left behind."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from tests.service.conftest import GOAL, IN_HOLE, NORTH, START, WEST


def npy(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def check_problem(answer: Any, status: int, code: str, *words: str) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = json.loads(answer.text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert (body["status"], body["code"]) == (status, code)
    assert body["title"]
    assert body["request_id"] == answer.headers["x-request-id"]
    for word in words:
        assert word in body["detail"], body["detail"]
    return body


def left_in(data_dir: Path) -> list[Path]:
    """Files of uploads; the lock of the running service is none."""
    return [path for path in (data_dir / "uploads").rglob("*") if path.is_file() and path.suffix != ".lock"]


@pytest.fixture(autouse=True)
def _nothing_is_left(client: TestClient) -> Iterator[None]:
    """No upload stays behind, and no heightmap is kept of a file that was refused."""
    store = client.app.state.service.store  # type: ignore[attr-defined]
    before = set(Path(store._dir).rglob("*.tif"))
    yield
    assert left_in(Path(store._dir)) == []
    assert set(Path(store._dir).rglob("*.tif")) == before


BAD_FILES = [
    (b"", {}, 422, "invalid_heightmap", "empty"),
    (b"certainly no picture", {}, 422, "invalid_heightmap", "not a heightmap"),
    (b"\x89PNG\r\n\x1a\n" + b"\0" * 40, {"scale_m": 0.1, "resolution_m": 1}, 422, "invalid_heightmap", "corrupt"),
    (npy(np.zeros((5, 5))), {"resolution_m": 1e-300}, 422, "invalid_request", "0.001"),
    (npy(np.zeros((5, 5))), {"resolution_m": 1, "west_m": 1e308}, 422, "invalid_request", "1000000000"),
    (npy(np.full((5, 5), -9999.0)), {"resolution_m": 1}, 422, "invalid_heightmap", "`nodata` as -9999"),
    (npy(np.full((5, 5), -9999.0)), {"resolution_m": 1, "nodata": -9999}, 422, "invalid_heightmap", "unknown"),
    (npy(np.zeros((5, 5))), {}, 422, "invalid_heightmap", "resolution_m"),
    (npy(np.zeros((5, 5))), {"resolution_m": -1}, 422, "invalid_request", "resolution"),
    (npy(np.full((5, 5), np.nan)), {"resolution_m": 1}, 422, "invalid_heightmap", "unknown"),
    (npy(np.zeros((5, 5))), {"resolution_m": 1, "crs": "EPSG:4326"}, 422, "invalid_heightmap", "degrees"),
    (npy(np.zeros((5, 5))), {"resolution_m": "nan"}, 422, "invalid_request", "resolution_m"),
    (npy(np.zeros((5, 5))), {"resolution": "1"}, 422, "invalid_request", "resolution"),
    (
        npy(np.zeros((2, 2))).replace(b"(2, 2)", b"(31623, 31623)"),
        {"resolution_m": 1},
        413,
        "too_large",
        "limit of 1000000",
    ),
]


@pytest.mark.parametrize(("data", "params", "status", "code", "word"), BAD_FILES)
@pytest.mark.parametrize("how", ["raw", "form"])
def test_bad_files(client: TestClient, data: bytes, params: dict, status: int, code: str, word: str, how: str) -> None:
    if how == "raw":
        answer = client.post("/v1/heightmaps", params=params, content=data)
    else:
        answer = client.post("/v1/heightmaps", data=params, files={"file": ("map.bin", data)})
    check_problem(answer, status, code, word)


def test_truncated_and_contradicted_geotiff(client: TestClient, hill_tif: bytes) -> None:
    check_problem(
        client.post("/v1/heightmaps", content=hill_tif[: len(hill_tif) // 2]), 422, "invalid_heightmap", "truncated"
    )
    wrong = client.post("/v1/heightmaps?resolution_m=2", content=hill_tif)
    body = check_problem(wrong, 422, "invalid_heightmap", "2 m was given", "1 m")
    assert body["context"] == {"resolution_m": 2.0, "file_resolution_m": 1.0}


def test_a_form_without_a_file(client: TestClient) -> None:
    check_problem(client.post("/v1/heightmaps", files={"other": b"x"}), 422, "invalid_input", "file")
    broken = client.post("/v1/heightmaps", content=b"x", headers={"Content-Type": "multipart/form-data"})
    check_problem(broken, 400, "bad_request")


def test_upload_declared_too_large_is_not_read(client: TestClient) -> None:
    def body() -> Iterator[bytes]:
        pytest.fail("the body was read")
        yield b""

    headers = {"Content-Length": str(2 * 10**9)}
    answer = client.post("/v1/heightmaps", content=body(), headers=headers)
    problem = check_problem(answer, 413, "too_large", "limit of 2 MB")
    assert problem["context"] == {"declared_bytes": 2 * 10**9, "limit_bytes": 2_000_000}


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/v1/heightmaps", "application/octet-stream"),
        ("/v1/heightmaps", "multipart/form-data; boundary=b"),
        ("/v1/costmaps", "multipart/form-data; boundary=b"),
    ],
)
def test_chunked_upload_is_cut_off(path: str, kind: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Straight on the ASGI interface, where it can be seen how much was taken of an endless body."""
    import anyio

    from joulemap.service.http.app import create_app
    from tests.service.conftest import settings_for

    app = create_app(settings_for(tmp_path_factory.mktemp("data"), max_upload_mb=1.0))
    taken = 0
    sent: list[dict] = []

    async def receive() -> dict:
        nonlocal taken
        start = b'--b\r\nContent-Disposition: form-data; name="file"; filename="f"\r\n\r\n' if taken == 0 else b""
        taken += 100_000
        return {"type": "http.request", "body": start.ljust(100_000, b"x"), "more_body": True}

    async def send(message: dict) -> None:
        sent.append(message)

    async def main() -> None:
        async with app.router.lifespan_context(app):
            scope = {
                "type": "http",
                "asgi": {"version": "3.0"},
                "http_version": "1.1",
                "method": "POST",
                "scheme": "http",
                "path": path,
                "raw_path": path.encode(),
                "query_string": b"",
                "root_path": "",
                "headers": [
                    (b"host", b"localhost"),
                    (b"content-type", kind.encode()),
                    (b"transfer-encoding", b"chunked"),
                ],
                "client": ("test", 1),
                "server": ("test", 80),
            }
            await app(scope, receive, send)

    anyio.run(main)
    assert sent[0]["status"] == 413
    assert json.loads(sent[1]["body"])["code"] == "too_large"
    assert len(sent) == 2
    assert taken <= 1_200_000


BAD_COSTMAPS: list[tuple[dict, str, str]] = [
    ({"robot": {"mass_kg": -1}}, "invalid_request", "robot.mass_kg"),
    ({"robot": {"speed_mps": 1e-306}}, "invalid_request", "equal to 0.01, got 1e-306"),
    ({"robot": {"name": "r" * 1_000_000}}, "invalid_request", "at most 200 characters"),
    ({"robot": {"wings": 2}}, "invalid_request", "wings"),
    ({"robot": {"mass_kg": "heavy"}}, "invalid_request", "mass_kg"),
    ({"model": "nonsense"}, "invalid_model", "nonsense"),
    ({"model": "../../etc"}, "invalid_model", "../../etc"),
    ({"spacing_m": 100}, "invalid_heightmap", "too small"),
    ({"spacing_m": 0}, "invalid_request", "spacing_m"),
    ({"headings": 3}, "invalid_request", "headings"),
    ({"headings": 16.5}, "invalid_request", "headings"),
]


NEAREST: list[tuple[str, dict, str]] = [
    ("costmaps", {"robot": {"mass": 20}}, "robot.mass: unknown field; did you mean mass_kg?"),
    ("costmaps", {"robot": {"speed": 1.0}}, "robot.speed: unknown field; did you mean speed_mps?"),
    ("costmaps", {"heading": 8}, "heading: unknown field; did you mean headings?"),
    ("costmaps", {"robot": {"wings": 2}}, "robot.wings: unknown field; known are name, mass_kg"),
    ("costmaps/{}/paths", {"neighbors": 8}, "neighbors: unknown field; did you mean neighbours?"),
    ("costmaps/{}/paths", {"battery": {"capacity": 9}}, "battery.capacity: unknown field; did you mean capacity_wh?"),
    (
        "costmaps/{}/feasibility",
        {"battery": {"charge": 60}},
        "battery.charge: charge is 60; it lies between 0 and 1: for 60 % write 0.6",
    ),
    (
        "costmaps/{}/tours",
        {"stops": [START, GOAL], "battery": {"reserve": 12.5}},
        "battery.reserve: reserve is 12.5; it lies between 0 and 1: for 12.5 % write 0.125",
    ),
]


@pytest.mark.parametrize(("place", "change", "words"), NEAREST)
def test_what_was_probably_meant_is_said(
    client: TestClient, heightmap_id: str, costmap_id: str, place: str, change: dict, words: str
) -> None:
    asked = {"heightmap_id": heightmap_id} if place == "costmaps" else {"start": START, "goal": GOAL}
    if "stops" in change:
        asked = {}
    problem = check_problem(
        client.post(f"/v1/{place.format(costmap_id)}", json=asked | change), 422, "invalid_request", words
    )
    assert words in "; ".join(f"{e['field']}: {e['message']}" for e in problem["context"]["errors"])


def test_every_unknown_field_is_named_at_once(client: TestClient, costmap_id: str) -> None:
    asked = {"strat": START, "goal": GOAL, "robot": {"mass": 1, "width_m": "a"}, "refined": True}
    problem = check_problem(client.post(f"/v1/costmaps/{costmap_id}/paths", json=asked), 422, "invalid_request")
    assert sorted(e["field"] for e in problem["context"]["errors"]) == [
        "refined",
        "robot.mass",
        "robot.width_m",
        "start",
        "strat",
    ]


@pytest.mark.parametrize(("change", "code", "word"), BAD_COSTMAPS)
def test_bad_costmap_requests_are_answered_at_once(
    client: TestClient, heightmap_id: str, change: dict, code: str, word: str
) -> None:
    before = client.get("/v1/costmaps").json()["total"]
    body = {"heightmap_id": heightmap_id, "model": "physics", **change}
    check_problem(client.post("/v1/costmaps", json=body), 422, code, word)
    assert client.get("/v1/costmaps").json()["total"] == before


def test_too_many_lattice_values(client: TestClient, heightmap_id: str) -> None:
    body = {"heightmap_id": heightmap_id, "model": "physics", "spacing_m": 0.01, "headings": 360}
    check_problem(client.post("/v1/costmaps", json=body), 413, "too_large", "choose a larger spacing")


def test_other_bad_requests_for_a_costmap(client: TestClient, hill_tif: bytes) -> None:
    check_problem(client.post("/v1/costmaps", json={"heightmap_id": "hm-none"}), 404, "not_found", "hm-none")
    check_problem(client.post("/v1/costmaps", content=b"x"), 415, "unsupported_media_type")
    check_problem(
        client.post("/v1/costmaps", content=b"{", headers={"Content-Type": "application/json"}), 422, "invalid_request"
    )
    path = "/v1/costmaps/cm-none/paths"
    json_type = {"Content-Type": "application/json"}
    broken = check_problem(
        client.post(path, content=b'{"start": [1, 2],, }', headers=json_type), 422, "invalid_request"
    )
    assert broken["detail"].startswith("the body is no valid JSON: ")
    assert broken["detail"].endswith(" at character 17")
    for body, headers in ((b'{"start": [1, 2], "goal": [3, 4]}', {}), (b"[1, 2]", json_type)):
        wrong = check_problem(client.post(path, content=body, headers=headers), 422, "invalid_request")
        assert wrong["detail"] == "the body must be a JSON object with Content-Type: application/json"
    empty = check_problem(client.post(path, headers=json_type), 422, "invalid_request")
    assert empty["detail"] == "body: Field required"
    form = client.post("/v1/costmaps", files={"file": hill_tif}, data={"options": '{"model": "nonsense"}'})
    check_problem(form, 422, "invalid_model", "nonsense")


NAN, INF = float("nan"), float("inf")
BAD_PATHS: list[tuple[dict, int, str, str]] = [
    ({"start": [NAN, 1.0]}, 422, "invalid_request", "start.0"),
    ({"goal": [INF, 1.0]}, 422, "invalid_request", "goal.0"),
    ({"goal": [10**400, 1.0]}, 422, "invalid_request", "goal.0"),
    ({"start": ["1", 2]}, 422, "invalid_request", "start.0"),
    ({"start": [1.0]}, 422, "invalid_request", "start"),
    ({"start": None}, 422, "invalid_request", "start"),
    ({"start": IN_HOLE}, 422, "blocked", "blocked ground: unknown"),
    ({"goal": IN_HOLE}, 422, "blocked", "goal"),
    ({"goal": [WEST - 10.0, NORTH]}, 422, "invalid_point", "outside the map"),
    ({"planner": "teleport"}, 422, "invalid_request", "planner"),
    ({"neighbours": 7}, 422, "invalid_request", "neighbours"),
    ({"battery": {"charge": 1.5}}, 422, "invalid_request", "battery.charge"),
    ({"battery": {"capacity_wh": NAN}}, 422, "invalid_request", "battery.capacity_wh"),
    ({"robot": {"mass_kg": 50, "speed_mps": 0.5}}, 409, "conflict", "mass_kg 35.0, not 50.0"),
    ({"robot": {"mass_kg": -50}}, 422, "invalid_request", "mass_kg"),
]


@pytest.mark.parametrize(("change", "status", "code", "word"), BAD_PATHS)
def test_bad_questions(client: TestClient, costmap_id: str, change: dict, status: int, code: str, word: str) -> None:
    """As Python's json writes it: NaN and Infinity go out as such, and must come back as a clean problem."""
    body = json.dumps({"start": START, "goal": GOAL, **change})
    for question in ("paths", "feasibility"):
        if question == "feasibility" and {"planner", "neighbours"} & set(change):
            continue
        url = f"/v1/costmaps/{costmap_id}/{question}"
        check_problem(client.post(url, content=body, headers={"Content-Type": "application/json"}), status, code, word)


def test_other_robot_is_named(client: TestClient, costmap_id: str) -> None:
    body = {"start": START, "goal": GOAL, "robot": {"mass_kg": 35, "speed_mps": 1.0, "width_m": 0.4}}
    problem = check_problem(client.post(f"/v1/costmaps/{costmap_id}/paths", json=body), 409, "conflict", "speed_mps")
    assert problem["context"]["fields"] == ["speed_mps", "width_m"]
    same = {"start": START, "goal": GOAL, "robot": {"mass_kg": 35}}
    assert client.post(f"/v1/costmaps/{costmap_id}/paths", json=same).status_code == 200


def test_bad_tasks(client: TestClient, costmap_id: str) -> None:
    url = f"/v1/costmaps/{costmap_id}/feasibility"
    both = {"path": [START, GOAL], "start": START, "goal": GOAL}
    for task in ({}, both, {"start": START}):
        check_problem(client.post(url, json=task), 422, "invalid_request", "give either")
    check_problem(client.post(url, json={"path": [START]}), 422, "invalid_request", "path")
    through = {"path": [[IN_HOLE[0] - 5, IN_HOLE[1]], [IN_HOLE[0] + 4, IN_HOLE[1]]]}
    check_problem(client.post(url, json=through), 422, "blocked", "leg 0")


def test_unknown_things(client: TestClient) -> None:
    for path in ("heightmaps/hm-none", "costmaps/cm-none", "costmaps/cm-none/data", "costmaps/cm-none/image.png"):
        check_problem(client.get(f"/v1/{path}"), 404, "not_found", path.split("/")[1])
    check_problem(client.post("/v1/costmaps/cm-none/paths", json={"start": START, "goal": GOAL}), 404, "not_found")
    check_problem(client.get("/v2"), 404, "not_found", "/v2")
    wrong = client.put("/v1/heightmaps")
    check_problem(wrong, 405, "method_not_allowed")
    assert set(wrong.headers["allow"].split(", ")) >= {"POST"} or "GET" in wrong.headers["allow"]


@pytest.mark.parametrize("query", ["x=nan&y=1", "x=1&y=inf", "x=a&y=1", "lat=91&lon=0", "lat=0&lon=x"])
def test_bad_places(client: TestClient, costmap_id: str, query: str) -> None:
    check_problem(client.get(f"/v1/costmaps/{costmap_id}/at?{query}"), 422, "invalid_request")


@pytest.mark.parametrize("query", ["", "x=1", "lat=1", "x=1&lon=1", "x=1&y=1&lat=1&lon=1"])
def test_half_a_place_and_two(client: TestClient, costmap_id: str, query: str) -> None:
    check_problem(client.get(f"/v1/costmaps/{costmap_id}/at?{query}"), 422, "invalid_input")


def test_hostile_json(client: TestClient, costmap_id: str) -> None:
    url = f"/v1/costmaps/{costmap_id}/paths"
    for text in (b"[" * 100_000, b'{"start": ' + b"9" * 5000 + b"}", b'{"start": "\xff"}', b"\x00"):
        for target in (url, "/v1/costmaps"):
            answer = client.post(target, content=text, headers={"Content-Type": "application/json"})
            assert answer.status_code in (400, 422), answer.text
            check_problem(answer, answer.status_code, answer.json()["code"])


def _keys(count: int, *, length: int = 0) -> bytes:
    return json.dumps({f"{number}{'k' * length}": 1 for number in range(count)}).encode()


HUGE_BODIES = {
    "more keys than are read": _keys(500_000),
    "more keys than a request has": _keys(1_900),
    "some unknown keys": _keys(90),
    "long keys": _keys(900, length=7_000),
    "a key of megabytes": _keys(1, length=7_000_000),
    "deep lists": b'{"start": %b1%b}' % (b"[" * 100_000, b"]" * 100_000),
    "deep objects": b'{"start": ' * 900 + b"1" + b"}" * 900,
    "many wrong points": json.dumps(
        {name: [["x", None]] * 50_000 for name in ("path", "stops", "starts", "runs")}
    ).encode(),
    "long values": json.dumps({f"start_{n}": ["v" * 400] * 100 for n in range(99)}).encode(),
    "large values": json.dumps({"robot": {f"{n}": {f"{m}": "v" * 50 for m in range(10)} for n in range(90)}}).encode(),
}
POST_PLACES = ["costmaps", "calibrations", "costmaps/{}/paths"]  # all others are read by the same code


@pytest.mark.parametrize("place", POST_PLACES)
@pytest.mark.parametrize("kind", HUGE_BODIES)
def test_huge_json_gets_a_short_problem_soon(client: TestClient, costmap_id: str, place: str, kind: str) -> None:
    began = time.monotonic()
    url = f"/v1/{place.format(costmap_id)}"
    answer = client.post(url, content=HUGE_BODIES[kind], headers={"Content-Type": "application/json"})
    assert time.monotonic() - began < 3.0
    assert answer.status_code in (413, 422)
    check_problem(answer, answer.status_code, answer.json()["code"])
    assert len(answer.content) < 50_000
    assert len(answer.json()["context"].get("errors", [])) <= 20


def test_wheels_that_spin_for_thousands_of_kilometres_are_refused_at_once(client):
    rows = "".join(f"{0.1 * k:.1f},{9e5},{-9e5},2,24\n" for k in range(100))
    content = f"t,speed_left,speed_right,current,voltage\n{rows}".encode()
    how = {"name": "spin", "odometry_track_m": "1.0"}
    answer = client.post("/v1/runs", params=how, content=content, headers={"Content-Type": "text/csv"})
    check_problem(answer, 413, "too_large", "8910 km long")
