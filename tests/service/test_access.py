"""Who may: hosts and pages, keys, owners who do not see each other's things, and limits of one key."""

from __future__ import annotations

import datetime as dt
import io
import logging
import re
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from joulemap.model.errors import RateError
from joulemap.model.robot import Robot
from joulemap.service.cli import app
from joulemap.service.http import access
from joulemap.service.http.access import BURST_S, Buckets, warn_if_open
from joulemap.service.http.app import create_app
from joulemap.service.storage.owners import Caller, add_key, all_keys, revoke_keys
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import DONE, CalibrationRow, CostmapRow, HeightmapRow, KeyRow
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_calibrations import run_csv

PAGE = "https://maps.example"


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def sessions_of(client: TestClient) -> Any:
    return client.app.state.service.store.sessions  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def paged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """An open service that one foreign page may call."""
    settings = settings_for(
        tmp_path_factory.mktemp("data"), allowed_hosts="Maps.example:, rover.local", cors_origins=PAGE
    )
    with TestClient(create_app(settings), base_url="http://localhost:8000") as client:
        yield client


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1:8000", "[::1]", "[::1]:8000", "rover.local:80"]
)
def test_own_names_are_answered(paged: TestClient, host: str) -> None:
    assert paged.get("/v1", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        *("evil.example", "localhost.evil.example", "127.0.0.1.nip.io:8000", "xlocalhost", "", "[", "[::1", "::1"),
        *(
            "a@b",
            "evil.example@localhost",
            "localhost:evil.example",
            "localhost:80:80",
            "localhost:123456",
            "localhost/",
        ),
    ],
)
def test_other_names_are_refused(paged: TestClient, host: str) -> None:
    answer = paged.get("/v1", headers={"Host": host})
    assert answer.status_code == 403
    problem = answer.json()
    assert problem["code"] == "forbidden"
    assert problem["context"]["host"] == host
    assert "JOULEMAP_ALLOWED_HOSTS" in problem["detail"]
    assert answer.headers["x-request-id"] == problem["request_id"]


def test_a_request_has_one_host(paged: TestClient) -> None:
    answer = paged.get("/v1", headers=[("Host", "localhost"), ("Host", "evil.example")])
    assert (answer.status_code, answer.json()["context"]["host"]) == (403, "localhost, evil.example")


def test_probes_may_use_any_name(paged: TestClient) -> None:
    assert paged.get("/healthz", headers={"Host": "10.1.2.3"}).status_code == 200


def test_any_name_where_the_operator_says_so(tmp_path: Path) -> None:
    with TestClient(create_app(settings_for(tmp_path, allowed_hosts="*")), base_url="http://x.example") as client:
        assert client.get("/v1").status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:3000"},  # another port is another origin
        {"Origin": "http://localhost:80001"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"},
    ],
)
@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "/v1/heightmaps"), ("DELETE", "/v1/heightmaps/hm-1"), ("GET", "/v1/costmaps/cm-1/field"), ("PUT", "/v1")],
)
def test_foreign_pages_are_refused(
    paged: TestClient, method: str, path: str, headers: dict[str, str], hill_tif: bytes
) -> None:
    answer = paged.request(method, path, headers=headers, content=hill_tif if method == "POST" else None)
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")
    assert "access-control-allow-origin" not in answer.headers
    assert paged.get("/v1/heightmaps").json()["total"] == 0


def test_a_form_that_a_foreign_page_sends_with_navigation_is_refused(paged: TestClient, hill_tif: bytes) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    answer = paged.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)}, headers=headers)
    assert answer.status_code == 403
    assert paged.get("/v1", headers=headers).status_code == 200  # a link may be followed


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://localhost:8000"},
        {"Origin": PAGE},
        {"Sec-Fetch-Site": "same-origin"},
        {"Sec-Fetch-Site": "none"},
    ],
)
def test_own_and_named_pages_are_answered(paged: TestClient, headers: dict[str, str]) -> None:
    answer = paged.post("/v1/heightmaps", headers=headers, content=b"no heightmap")
    assert answer.status_code == 422
    assert answer.headers.get("access-control-allow-origin") == (PAGE if headers.get("Origin") == PAGE else None)


def test_a_named_page_may_ask_beforehand(paged: TestClient) -> None:
    asked = {
        "Origin": PAGE,
        "Access-Control-Request-Method": "DELETE",
        "Access-Control-Request-Headers": "authorization",
    }
    answer = paged.options("/v1/costmaps/cm-1", headers=asked)
    assert answer.status_code == 200
    assert "DELETE" in answer.headers["access-control-allow-methods"]
    assert paged.options("/v1/costmaps/cm-1", headers={**asked, "Origin": "http://evil.example"}).status_code == 403


def test_a_page_can_read_that_it_needs_a_key(tmp_path: Path) -> None:
    app = create_app(settings_for(tmp_path, cors_origins=PAGE))
    with TestClient(app) as client:
        add_key(sessions_of(client), "anna")
        answer = client.get("/v1", headers={"Origin": PAGE})
        assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (401, PAGE)
        asked = {"Origin": PAGE, "Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "x-api-key"}
        assert client.options("/v1/heightmaps", headers=asked).status_code == 200  # a browser sends no key with this


# keys


def test_an_open_service_says_so_loudly(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with TestClient(create_app(settings_for(tmp_path, host="0.0.0.0"))) as client:
        assert "THIS SERVICE IS OPEN" in caplog.text
        assert "joulemap keys add" in caplog.text
        store = client.app.state.service.store  # type: ignore[attr-defined]
        with caplog.at_level(logging.WARNING):
            for host in ("127.0.0.1", "localhost", "::1", "127.3.4.5"):
                caplog.clear()
                warn_if_open(store, host)
                assert not caplog.text
            warn_if_open(store, "rover.local")
            assert caplog.text
            caplog.clear()
            add_key(store.sessions, "anna")
            warn_if_open(store, "rover.local")
            assert not caplog.text


def test_a_key_is_needed_once_there_is_one_and_refused_once_it_is_revoked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with TestClient(create_app(settings_for(tmp_path))) as client:
        monkeypatch.setattr(access, "KNOWN_S", 0.0)  # look at the database for each request
        assert client.get("/v1/heightmaps").status_code == 200
        key = add_key(sessions_of(client), "anna")
        answer = client.get("/v1/heightmaps")
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
        assert answer.headers["www-authenticate"] == "Bearer"
        assert answer.headers["x-request-id"] == answer.json()["request_id"]
        for path in ("/", "/healthz", "/docs", "/docs/static/swagger-ui.css", "/openapi.json"):
            assert client.get(path).status_code == 200
        assert client.get("/docs/static/../../v1/heightmaps").status_code in (401, 404)
        for path in ("/v1", "/v1/", "//v1/heightmaps", "/docs/", "/nothing", "/%76%31/heightmaps"):
            assert client.get(path).status_code == 401, path
        for headers in (bearer(key), {"X-API-Key": key}, {"Authorization": f"bearer {key}"}):
            assert client.get("/v1/heightmaps", headers=headers).status_code == 200
        wrong = [
            key[:-1] + ("A" if key[-1] != "A" else "B"),
            key + "x",
            key[:11],
            "jm_00000000_" + "a" * 43,
            "",
            "é" * 55,
            key.upper(),
        ]
        for other in wrong:
            answer = client.get("/v1/heightmaps", headers={"X-API-Key": other.encode()})
            assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized"), other
            assert not other[12:] or other[12:] not in answer.text  # what was sent may be nearly a key
        second = add_key(sessions_of(client), "anna")
        assert revoke_keys(sessions_of(client), key[:11]) == 1
        assert client.get("/v1/heightmaps", headers=bearer(key)).status_code == 401
        assert client.get("/v1/heightmaps", headers=bearer(second)).status_code == 200
        assert revoke_keys(sessions_of(client), "anna") == 1
        assert client.get("/v1/heightmaps", headers=bearer(second)).status_code == 401
        assert client.get("/v1/heightmaps").status_code == 401  # it does not become open


def test_a_new_key_is_known_at_once(tmp_path: Path) -> None:
    with TestClient(create_app(settings_for(tmp_path))) as client:
        add_key(sessions_of(client), "anna")
        assert client.get("/v1").status_code == 401
        key = add_key(sessions_of(client), "bert")
        time.sleep(access._AGAIN_S)
        assert client.get("/v1", headers=bearer(key)).status_code == 200


def test_no_key_is_kept(tmp_path: Path) -> None:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'joulemap.db'}")
    store.open()
    keys = {add_key(store.sessions, "anna") for _ in range(20)}
    rows = all_keys(store.sessions)
    store.close()
    assert len(keys) == len({row.prefix for row in rows}) == 20
    assert all(re.fullmatch(r"jm_[0-9a-f]{8}_[\w-]{43}", key) for key in keys)
    on_disk = b"".join(path.read_bytes() for path in tmp_path.iterdir() if path.is_file())
    assert not any(key[12:].encode() in on_disk for key in keys)


def test_keys_on_the_command_line(tmp_path: Path) -> None:
    def call(*words: str) -> tuple[int, str]:
        out = io.StringIO()
        with pytest.raises(SystemExit) as ended, redirect_stdout(out):
            app(["keys", *words, "--data-dir", str(tmp_path)])
        return int(ended.value.code or 0), out.getvalue()

    assert "no keys" in call("list")[1]
    code, words = call("add", "anna", "--jobs", "2", "--operator")
    assert code == 0
    key = words.split()[0]
    code, words = call("list")
    assert key[:11] in words
    assert key not in words
    assert "anna (operator)" in words
    assert "2 jobs at most" in words
    assert call("add", "../x")[0] == 3
    assert call("revoke", "bert")[0] == 5
    assert call("revoke", "anna")[0] == 0
    assert call("revoke", "anna")[0] == 5
    assert "revoked" in call("list")[1]


# owners


@pytest.fixture(scope="module")
def shared(
    tmp_path_factory: pytest.TempPathFactory, hill_tif: bytes
) -> Iterator[tuple[TestClient, dict[str, str], dict[str, str]]]:
    """A service with things of anna, the keys of anna, bert and an operator, and the ids of anna's things."""
    folder = tmp_path_factory.mktemp("data")
    with TestClient(create_app(settings_for(folder))) as client:
        before = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        keys = {name: add_key(sessions_of(client), name) for name in ("anna", "bert")}
        keys["operator"] = add_key(sessions_of(client), "operator", operator=True)
        anna = bearer(keys["anna"])
        time.sleep(access.KNOWN_S)
        ids = {
            "heightmap_id": client.post("/v1/heightmaps", content=hill_tif, headers=anna).json()["id"],
            "before": before,
        }
        asked = {"heightmap_id": ids["heightmap_id"], "model": "physics"}
        ids["costmap_id"] = client.post("/v1/costmaps", json=asked, headers={**anna, "Prefer": "wait=60"}).json()["id"]
        ids["runs_id"] = client.post("/v1/runs", content=run_csv(0, metres=30.0), headers=anna).json()["id"]
        ids["calibration_id"] = "cal-0123456789ab"
        with sessions_of(client).begin() as session:
            session.add(
                CalibrationRow(
                    id=ids["calibration_id"],
                    created_at=dt.datetime(2026, 1, 1),
                    heightmap_id=ids["heightmap_id"],
                    request={
                        "runs": [ids["runs_id"]],
                        "base_runs": [],
                        "test_runs": [],
                        "model": "physics",
                        "robot": Robot().as_dict(),
                        "start": None,
                        "goal": None,
                        "seed": 0,
                    },
                    status=DONE,
                    progress=1.0,
                    summary={"report": {}, "model": ids["calibration_id"]},
                    owner="anna",
                )
            )
        (folder / "models" / ids["calibration_id"]).mkdir(parents=True)
        begun = client.post(f"/v1/costmaps/{ids['costmap_id']}/drives", json=BODIES["/drives"], headers=anna)
        ids["drive_id"] = begun.json()["id"]
        yield client, keys, ids


def operations(client: TestClient) -> list[tuple[str, str]]:
    paths = client.get("/openapi.json").json()["paths"]
    return [(method, path) for path, methods in paths.items() for method in methods]


QUERIES = {
    "/at": {"x": START[0], "y": START[1]},
    "/roses": {"west": START[0], "south": START[1], "east": START[0] + 5.0, "north": START[1] + 5.0},
}
BODIES = {
    "/paths": {"start": START, "goal": GOAL},
    "/tours": {"stops": [START, GOAL]},
    "/matrix": {"starts": [START], "goals": [GOAL]},
    "/feasibility": {"start": START, "goal": GOAL},
    "/reach": {"start": START},
    "/return": {"position": START, "home": GOAL},
    "/charging": {"start": START, "goal": GOAL, "at": [GOAL], "power_w": 100.0},
    "/speeds": {"start": START, "goal": GOAL},
    "/drives": {"path": [START, GOAL]},
    "/updates": {"samples": [{"time_s": 0.0, "position": START, "power_w": 10.0}]},
}


def test_what_others_own_is_not_there(shared: tuple[TestClient, dict[str, str], dict[str, str]]) -> None:
    """Every operation on an id answers a foreign id as it answers one that does not exist."""
    client, keys, ids = shared
    walked = 0
    for method, path in operations(client):
        names = re.findall(r"{(\w+_id)}", path)
        if not names:
            continue
        walked += 1
        answers = []
        for known in (ids, dict.fromkeys(ids, "cm-000000000000")):
            url = re.sub(r"{(\w+_id)}", lambda found, known=known: known[found[1]], path)
            body = next((body for end, body in BODIES.items() if path.endswith(end)), None)
            query = next((query for end, query in QUERIES.items() if path.endswith(end)), None)
            answer = client.request(method, url, params=query, json=body, headers=bearer(keys["bert"]))
            text = re.sub(r"(hm|cm|runs|cal|dr)-[0-9a-f]{12}", "ID", answer.text)
            answers.append((answer.status_code, re.sub(r'"request_id":\s*"\w+"', "", text)))
        assert answers[0] == answers[1], (method, path)
        assert answers[0][0] == 404, (method, path, answers[0])
    assert walked >= 15
    for name in ("heightmap", "costmap", "calibration"):
        there = client.get(f"/v1/{name}s/{ids[f'{name}_id']}", headers=bearer(keys["anna"]))
        assert there.status_code == 200, there.text


def test_lists_have_ones_own_only(shared: tuple[TestClient, dict[str, str], dict[str, str]]) -> None:
    client, keys, ids = shared
    for kind, mine in (("heightmaps", 1), ("costmaps", 1), ("runs", 1), ("calibrations", 1)):
        counts = {}
        for name, key in keys.items():
            page = client.get(f"/v1/{kind}", headers=bearer(key)).json()
            assert page["total"] == len(page["items"])
            counts[name] = page["total"]
        assert counts == {"anna": mine, "bert": 0, "operator": mine + (kind == "heightmaps")}, kind
    before = f"/v1/heightmaps/{ids['before']}"
    assert [client.get(before, headers=bearer(key)).status_code for key in keys.values()] == [404, 404, 200]


def test_nothing_is_made_from_what_others_own(
    shared: tuple[TestClient, dict[str, str], dict[str, str]], hill_tif: bytes
) -> None:
    client, keys, ids = shared
    bert = bearer(keys["bert"])
    mine = client.post("/v1/heightmaps", content=hill_tif, headers=bert).json()["id"]
    my_runs = client.post("/v1/runs", content=run_csv(1, metres=30.0), headers=bert).json()["id"]
    theirs = {"heightmap_id": ids["heightmap_id"], "model": "physics"}
    assert client.post("/v1/costmaps", json=theirs, headers=bert).status_code == 404
    assert (
        client.post(
            f"/v1/runs?heightmap_id={ids['heightmap_id']}", content=run_csv(0, metres=30.0), headers=bert
        ).status_code
        == 404
    )
    for asked in (
        {**theirs, "runs": [my_runs]},
        {"heightmap_id": mine, "runs": [ids["runs_id"]]},
        {"heightmap_id": mine, "runs": [my_runs], "test_runs": [ids["runs_id"]]},
        {"heightmap_id": mine, "runs": [my_runs], "baseline_runs": [ids["runs_id"]]},
    ):
        answer = client.post("/v1/calibrations", json=asked, headers=bert)
        assert answer.status_code == 404, (asked, answer.text)
    with_model = {"heightmap_id": mine, "model": ids["calibration_id"]}
    foreign = client.post("/v1/costmaps", json=with_model, headers=bert)
    unknown = client.post("/v1/costmaps", json={**with_model, "model": "cal-ffffffffffff"}, headers=bert)
    assert foreign.status_code == unknown.status_code == 422
    assert foreign.json()["context"]["known"] == unknown.json()["context"]["known"]
    assert ids["calibration_id"] not in unknown.text
    for made in (f"/v1/heightmaps/{mine}", f"/v1/runs/{my_runs}"):
        assert client.delete(made, headers=bert).status_code == 204


def test_what_nobody_owns_can_be_adopted(tmp_path: Path, hill_tif: bytes) -> None:
    with TestClient(create_app(settings_for(tmp_path))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        keys = {name: add_key(sessions_of(client), name, adopt=name == "anna") for name in ("bert", "anna")}
        time.sleep(access.KNOWN_S)
        statuses = [client.get(f"/v1/heightmaps/{heightmap}", headers=bearer(key)).status_code for key in keys.values()]
        assert statuses == [404, 200]


# limits of one key


def test_a_bucket_lets_bursts_pass_and_then_its_rate() -> None:
    now = 100.0
    buckets = Buckets(clock=lambda: now)
    passed = {"anna": 0, "bert": 0}

    def ask(name: str, times: int) -> float:
        wait = 0.0
        for _ in range(times):
            try:
                buckets.take(name, 2.0)
                passed[name] += 1
            except RateError as error:
                wait = error.context["retry_after_s"]
        return wait

    assert ask("anna", 100) == pytest.approx(0.5)
    assert passed["anna"] == 2 * BURST_S
    assert ask("bert", 1) == 0.0  # another owner is not held up
    now += 3.0
    ask("anna", 100)
    assert passed["anna"] == 2 * BURST_S + 6
    now += 0.5
    assert ask("anna", 1) == 0.0
    now += 1e6
    ask("anna", 1000)
    assert passed["anna"] == 4 * BURST_S + 7


def test_too_many_requests_of_one_key(tmp_path: Path) -> None:
    with TestClient(create_app(settings_for(tmp_path, key_requests_per_s=0.5))) as client:
        key = add_key(sessions_of(client), "anna")
        other = add_key(sessions_of(client), "bert", requests_per_s=1000.0)
        statuses = [client.get("/v1", headers=bearer(key)).status_code for _ in range(8)]
        assert statuses == [200] * 5 + [429] * 3
        answer = client.get("/v1", headers=bearer(key))
        assert 1 <= int(answer.headers["retry-after"]) <= 2
        assert answer.json()["context"]["limit_per_s"] == 0.5
        assert {client.get("/v1", headers=bearer(other)).status_code for _ in range(20)} == {200}
        assert client.get("/healthz").status_code == 200


def test_jobs_at_once_and_bytes_of_one_key(tmp_path: Path, hill_tif: bytes) -> None:
    settings = settings_for(tmp_path, workers=0, key_jobs=2)  # nothing is built, so jobs wait
    with TestClient(create_app(settings)) as client:
        anna = bearer(add_key(sessions_of(client), "anna"))
        small = bearer(add_key(sessions_of(client), "bert", gb=2.2 * len(hill_tif) / 1e9))
        sent = [client.post("/v1/heightmaps", content=hill_tif, headers=anna).json()["id"] for _ in range(3)]
        asked = [
            client.post("/v1/costmaps", json={"heightmap_id": sent[0], "model": "physics"}, headers=anna)
            for _ in range(4)
        ]
        assert [answer.status_code for answer in asked] == [202, 202, 429, 429]
        assert asked[3].json()["context"] == {"jobs": 2, "limit": 2, "retry_after_s": 10.0}
        assert asked[3].headers["retry-after"] == "10"
        assert client.delete(asked[0].headers["location"], headers=anna).status_code == 204
        assert (
            client.post("/v1/costmaps", json={"heightmap_id": sent[0], "model": "physics"}, headers=anna).status_code
            == 202
        )

        full = [client.post("/v1/heightmaps", content=hill_tif, headers=small) for _ in range(4)]
        assert full[0].status_code == 201
        assert full[-1].status_code == 507
        context = full[-1].json()["context"]
        assert context["kept_bytes"] + context["more_bytes"] > context["limit_bytes"] == int(2.2 * len(hill_tif))
        kept = [answer.json()["id"] for answer in full if answer.status_code == 201]
        assert (
            client.post("/v1/costmaps", json={"heightmap_id": kept[0], "model": "physics"}, headers=small).status_code
            == 507
        )
        files = {path.stem for path in (tmp_path / "heightmaps").iterdir()}
        assert files == {*sent, *kept}  # a refused one leaves no file
        assert client.delete(f"/v1/heightmaps/{kept[0]}", headers=small).status_code == 204
        assert client.post("/v1/heightmaps", content=hill_tif, headers=small).status_code == 201


def test_requests_at_the_same_moment_pass_no_limit_together(tmp_path: Path, hill_tif: bytes) -> None:
    from concurrent.futures import ThreadPoolExecutor

    with TestClient(create_app(settings_for(tmp_path, workers=0, key_jobs=3))) as client:
        anna = bearer(add_key(sessions_of(client), "anna"))
        heightmap = client.post("/v1/heightmaps", content=hill_tif, headers=anna).json()["id"]
        body = {"heightmap_id": heightmap, "model": "physics"}
        with ThreadPoolExecutor(16) as pool:
            answers = list(
                pool.map(lambda _: client.post("/v1/costmaps", json=body, headers=anna).status_code, range(24))
            )
        assert sorted(answers) == [202] * 3 + [429] * 21


def test_what_is_kept_is_measured(shared: tuple[TestClient, dict[str, str], dict[str, str]]) -> None:
    """A cost map counts with its real size once it is done; sizes are those of the files."""
    client, _, ids = shared
    store = client.app.state.service.store  # type: ignore[attr-defined]
    with sessions_of(client)() as session:
        costmap, heightmap = session.get(CostmapRow, ids["costmap_id"]), session.get(HeightmapRow, ids["heightmap_id"])
        assert session.get(KeyRow, "jm_00000000") is None
    folder = store.lattice_path(ids["costmap_id"])
    assert costmap.bytes == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) > 1000
    assert heightmap.bytes == store.path(HeightmapRow, ids["heightmap_id"]).stat().st_size
    assert not Caller(name=None, sees_all=False).may_see(heightmap)
    assert not Caller(name=None, sees_all=False).may_see(HeightmapRow(owner=None))
