"""What an operator sees of a service: readiness, metrics, request ids, logs, and the progress of jobs."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy.exc import OperationalError

from joulemap.service.http import watched as health_module
from joulemap.service.http.job_events import JobEvents, JobState
from joulemap.service.http.logs import JsonLines, TextLines, WithRequestId, WrittenByAThread, log_config
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.observed import Observed
from joulemap.service.http.watched import OK, Health
from tests.service.conftest import GOAL, START
from tests.service.test_restart import wait_until as until

GENEROUS_S = 30.0


def numbers(client: TestClient) -> dict[str, float]:
    """The metrics by name and labels."""
    lines = client.get("/metrics").text.splitlines()
    return {line.rpartition(" ")[0]: float(line.rpartition(" ")[2]) for line in lines if not line.startswith("#")}


def ask_path(client: TestClient, costmap_id: str, **change: object):  # type: ignore[no-untyped-def]
    return client.post(f"/v1/costmaps/{costmap_id}/paths", json={"start": START, "goal": GOAL, **change})


def test_many_questions_at_once_to_one_map_have_the_answers_of_one_at_a_time(client, costmap_id):
    ends = [[[START[0] + 0.7 * k, START[1]], [GOAL[0], GOAL[1] + 0.5 * k]] for k in range(8)]

    def energy(pair):  # type: ignore[no-untyped-def]
        answer = ask_path(client, costmap_id, start=pair[0], goal=pair[1], snap=True)
        assert answer.status_code == 200, answer.text
        return answer.json()["energy_j"]

    alone = [energy(pair) for pair in ends]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(energy, ends)) == alone


def test_metrics_count_questions_and_tell_of_queues_jobs_and_files(client, costmap_id):
    before = numbers(client)
    assert ask_path(client, costmap_id).status_code == 200
    assert client.get("/v1/costmaps/cm-none").status_code == 404
    assert client.get("/nothing/here").status_code == 404
    after = numbers(client)

    def grew(name: str) -> float:
        return after[name] - before.get(name, 0.0)

    count = "joulemap_http_request_seconds_count"
    assert grew(f'{count}{{method="POST",route="/v1/costmaps/{{costmap_id}}/paths",status="200"}}') == 1.0
    assert grew(f'{count}{{method="GET",route="/v1/costmaps/{{costmap_id}}",status="404"}}') == 1.0
    assert grew(f'{count}{{method="GET",route="unmatched",status="404"}}') == 1.0
    assert grew('joulemap_queue_work_seconds_count{queue="plans"}') == 1.0
    assert after['joulemap_queue_slots{queue="plans"}'] >= 1.0
    assert after['joulemap_queue_waiting{queue="plans"}'] == 0.0
    assert after['joulemap_check_passed{check="database"}'] == 1.0
    assert grew("joulemap_costmap_cache_hits_total") == 1.0
    assert after["joulemap_event_loop_stall_seconds_count"] > 0.0
    until(lambda: numbers(client).get('joulemap_jobs{kind="cost map",status="done"}', 0.0) >= 1.0)
    assert 'joulemap_data_bytes{folder="heightmaps"}' in after


def test_the_request_id_is_the_caller_s_where_it_is_a_good_one(client):
    assert client.get("/healthz", headers={"X-Request-ID": "robot-7.42"}).headers["X-Request-ID"] == "robot-7.42"
    assert client.get("/v1/nowhere", headers={"X-Request-ID": "robot-7"}).json()["request_id"] == "robot-7"
    made = client.get("/healthz", headers={"X-Request-ID": "no\x7f spaces"}).headers["X-Request-ID"]
    assert re.fullmatch("[0-9a-f]{16}", made)


def test_no_request_writes_a_line_that_is_not_its_own(client, caplog):
    with caplog.at_level(logging.INFO, logger="joulemap.access"):
        client.get("/v1/heightmaps/a%0D%0A2026-11-24 ERROR forged%00%1B%5B31m%E2%80%A8")
    record = next(r for r in caplog.records if r.name == "joulemap.access")
    line = TextLines("%(levelname)s %(message)s").format(record)
    assert line.startswith("INFO GET /v1/heightmaps/a\\x0d\\x0a2026-11-24 ERROR forged\\x00\\x1b[31m\\x2028 404")
    assert line.isprintable()


def test_every_request_is_a_line_of_json_with_its_id(client, costmap_id, caplog):
    with caplog.at_level(logging.INFO, logger="joulemap.access"):
        caplog.handler.addFilter(WithRequestId())
        client.get(f"/v1/costmaps/{costmap_id}", headers={"X-Request-ID": "a-1"})
        client.get("/healthz")
    record = next(r for r in caplog.records if r.name == "joulemap.access")
    line = json.loads(JsonLines().format(record))
    assert (line["request_id"], line["status"], line["method"]) == ("a-1", 200, "GET")
    assert (line["route"], line["path"]) == ("/v1/costmaps/{costmap_id}", f"/v1/costmaps/{costmap_id}")
    assert line["seconds"] > 0.0
    assert "\n" not in JsonLines().format(record)
    assert not any("/healthz" in r.getMessage() for r in caplog.records)  # probes would fill the log


@pytest.mark.parametrize("kind", ["text", "json"])
def test_the_configuration_of_the_log_is_valid(kind, capsys):
    from logging.config import dictConfig

    root, known = logging.getLogger(), {name: logging.getLogger(name).level for name in ("joulemap", "uvicorn.access")}
    handlers, level = list(root.handlers), root.level
    try:
        dictConfig(log_config(kind))
        logging.getLogger("joulemap.service").info("hello %s", "there")
    finally:
        for made in set(root.handlers) - set(handlers):
            made.close()  # which writes what waits
        root.handlers[:] = handlers
        root.setLevel(level)
        for name, was in known.items():
            logging.getLogger(name).setLevel(was)
    said = capsys.readouterr().err
    assert "hello there" in said
    if kind == "json":
        assert json.loads(said)["logger"] == "joulemap.service"


def test_who_logs_does_not_wait_for_a_reader_of_the_log_that_has_stopped(monkeypatch):
    reading, writing = os.pipe()  # whose buffer is full after 64 kB
    pipe = os.fdopen(writing, "w")
    monkeypatch.setattr(sys, "stderr", pipe)
    handler = WrittenByAThread("text")
    logger = logging.Logger("of this test")
    logger.addHandler(handler)
    for number in range(3_000):
        logger.info("%d %s", number, "x" * 100)  # would wait here
    lines: list[str] = []
    with os.fdopen(reading) as read:
        reader = threading.Thread(target=lambda: lines.extend(read))
        reader.start()
        handler.close()
        pipe.close()
        reader.join()
    assert [int(line.split("] ")[1].split()[0]) for line in lines] == list(range(3_000))


def test_readiness_tells_a_full_disk_and_a_lost_database_and_liveness_does_not(client, monkeypatch):
    service = client.app.state.service
    until(lambda: client.get("/readyz").status_code == 200)
    checks = client.get("/readyz").json()["checks"]
    assert {"database", "disk", "files"} <= set(checks)
    assert set(checks.values()) == {OK}

    class Disk:
        free = 1_000_000

    def lost(*_args):  # type: ignore[no-untyped-def]
        raise OperationalError("select", {}, Exception("server closed the connection"))

    for target, name, value, word in (
        (health_module.shutil, "disk_usage", lambda _folder: Disk(), "the disk is full: 1 MB are free"),
        (service.store, "_sessions", lost, "server closed the connection"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(target, name, value)
            until(lambda: client.get("/readyz").status_code == 503)
            answer = client.get("/readyz")
            assert word in answer.json()["detail"]
            assert int(answer.headers["Retry-After"]) >= 1
            assert client.get("/healthz").status_code == 200
        until(lambda: client.get("/readyz").status_code == 200)


def test_a_check_that_hangs_has_failed_and_keeps_nobody_waiting():
    now, hang = [0.0], threading.Event()
    health = Health(clock=lambda: now[0])
    looks = [0]

    def look() -> None:
        looks[0] += 1
        if looks[0] > 1:
            hang.wait(GENEROUS_S)

    health.add("engine", look, every_s=0.01)
    assert health.results() == {"engine": "not looked at yet"}
    health.start()
    until(lambda: looks[0] == 2)
    assert health.results() == {"engine": OK}
    now[0] = 100.0
    assert "no answer for" in health.results()["engine"]
    hang.set()
    until(lambda: health.results()["engine"] == OK)
    health.stop()


def test_a_stalled_event_loop_is_seen():
    async def stall() -> Metrics:
        metrics = Metrics()
        watching = asyncio.create_task(metrics.watch_loop())
        await asyncio.sleep(0.05)
        time.sleep(0.2)
        await asyncio.sleep(0.05)
        watching.cancel()
        return metrics

    metrics = asyncio.run(stall())
    assert metrics.worst_stall_s() >= 0.15
    assert b'joulemap_event_loop_stall_seconds_bucket{le="0.1"}' in metrics.text()


def test_the_progress_of_a_job_comes_as_events(client, costmap_id, heightmap_id):
    def told(job_id: str) -> list[tuple[str, dict]]:
        text = client.get(f"/v1/costmaps/{job_id}/events").text.replace("\r\n", "\n")
        found = re.findall(r"event: (\w+)\ndata: (.*)\n", text)
        return [(name, json.loads(data)) for name, data in found]

    assert told(costmap_id) == [("end", {"id": costmap_id, "status": "done", "progress": 1.0})]
    assert client.get("/v1/costmaps/cm-none/events").status_code == 404
    asked = {"heightmap_id": heightmap_id, "model": "physics", "headings": 8}
    made = client.post("/v1/costmaps", json=asked).json()["id"]
    *progress, (last, state) = told(made)
    assert {name for name, _ in progress} <= {"progress"}
    assert (last, state["status"]) == ("end", "done")
    shares = [state["progress"] for _, state in progress]
    assert shares == sorted(shares)


def test_all_who_follow_jobs_share_one_look_and_a_lost_database_comes_back():
    looks: list[set[str]] = []

    def look(ids):  # type: ignore[no-untyped-def]
        looks.append(set(ids))
        if len(looks) in (2, 3):
            raise OperationalError("select", {}, Exception("gone"))
        share = min(len(looks) / 6.0, 1.0)
        states = {"cm-1": JobState("done" if share == 1.0 else "running", share)}
        return {name: state for name, state in states.items() if name in ids}

    async def follow():  # type: ignore[no-untyped-def]
        events = JobEvents(look)

        async def seen(job_id: str) -> list:
            return [state async for state in events.follow(job_id)]

        first, second, deleted = await asyncio.gather(seen("cm-1"), seen("cm-1"), seen("cm-2"))
        assert first == second
        assert first[-1] == JobState("done", 1.0)
        assert deleted == [None]
        began = len(looks)
        await events.until_over("cm-1", GENEROUS_S)
        await asyncio.sleep(0.1)
        assert len(looks) == began + 1  # nobody follows, so nobody looks

    asyncio.run(follow())
    assert looks[0] == {"cm-1", "cm-2"}
    assert len(looks) <= 8


def test_a_cancelled_job_keeps_its_record(client, heightmap_id):
    """Cancelled at once, whatever has begun by then: it ends as cancelled, or was done before."""
    service = client.app.state.service
    asked = {"heightmap_id": heightmap_id, "model": "physics", "spacing_m": 0.25, "headings": 64}
    made = client.post("/v1/costmaps", json=asked).json()["id"]
    answer = client.post(f"/v1/costmaps/{made}/cancel")
    assert (answer.status_code, answer.json()["status"]) == (200, "cancelled")
    assert answer.json()["finished_at"] is not None
    assert client.post(f"/v1/costmaps/{made}/cancel").json()["status"] == "cancelled"  # once more changes nothing
    until(lambda: made not in service.store.wanted())
    time.sleep(0.5)
    assert client.get(f"/v1/costmaps/{made}").json()["status"] == "cancelled"
    refused = ask_path(client, made)
    assert refused.status_code == 409
    assert "was cancelled" in refused.json()["detail"]
    assert '"status": "cancelled"' in client.get(f"/v1/costmaps/{made}/events").text
    assert made in {item["id"] for item in client.get("/v1/costmaps?limit=1000").json()["items"]}
    assert client.delete(f"/v1/costmaps/{made}").status_code == 204
    assert client.post(f"/v1/costmaps/{made}/cancel").status_code == 404


def test_what_is_done_cannot_be_cancelled(client, costmap_id):
    answer = client.post(f"/v1/costmaps/{costmap_id}/cancel")
    assert answer.status_code == 409
    assert "is done" in answer.json()["detail"]
    assert client.get(f"/v1/costmaps/{costmap_id}").json()["status"] == "done"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc keeps freed blocks")
def test_freed_arrays_are_given_back():
    """Blocks of 4 MB between small ones that stay: without the call most of what is freed is kept."""
    code = """if True:
        import os, sys
        from joulemap.service.hosting.system import give_back_freed_memory
        def held():
            return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
        bytearray(30_000_000)  # glibc raises its threshold when such a block is freed
        before, blocks, small = held(), [], []
        for _ in range(50):
            blocks.append(bytearray(4_000_000))
            small.append(bytearray(100_000))
        blocks.clear()
        kept = held() - before
        given = give_back_freed_memory()
        print(kept, held() - before, given)
    """
    usual = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}  # Dask sets some
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=usual)
    kept, after, given = out.stdout.split()
    assert given == "True"
    assert float(after) < 20 < 150 < float(kept)


@pytest.mark.parametrize("begun", [False, True])
def test_a_request_that_is_cut_off_is_told_why_where_no_answer_has_begun(begun: bool) -> None:
    sent: list[dict[str, Any]] = []

    async def slow(_scope: Any, _receive: Any, send: Any) -> None:
        if begun:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        await asyncio.sleep(60.0)

    async def cut_off() -> None:
        async def send(message: Any) -> None:
            sent.append(message)

        scope = {"type": "http", "method": "GET", "path": "/v1", "headers": [(b"x-request-id", b"one")]}
        request = asyncio.create_task(Observed(slow, metrics=Metrics())(scope, None, send))  # type: ignore[arg-type]
        await asyncio.sleep(0.01)
        request.cancel()
        await request

    asyncio.run(cut_off())
    if begun:
        assert [message["type"] for message in sent] == ["http.response.start"]
    else:
        start, body = sent
        problem = json.loads(body["body"])
        assert (start["status"], problem["code"], problem["request_id"]) == (503, "busy", "one")
        assert (b"retry-after", b"10") in start["headers"]
