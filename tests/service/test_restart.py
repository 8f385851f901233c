"""What is kept survives a restart, and jobs end whatever happens to the service, its workers or its disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from joulemap.model.errors import ConflictError
from joulemap.service.http.app import create_app
from joulemap.service.storage.store import Store
from tests.service.clusters import free_port
from tests.service.conftest import GOAL, START, settings_for
from tests.service.preload import disturbed

ROOT = Path(__file__).resolve().parents[2]
PHYSICS = {"model": "physics", "headings": 8}
WAIT = {"Prefer": "wait=100"}


def test_everything_survives_a_restart(tmp_path: Path, hill_tif: bytes) -> None:
    question = {"start": START, "goal": GOAL}
    with TestClient(create_app(settings_for(tmp_path))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()
        costmap = client.post("/v1/costmaps", json={"heightmap_id": heightmap["id"], **PHYSICS}, headers=WAIT).json()
        path = client.post(f"/v1/costmaps/{costmap['id']}/paths", json=question).json()
    with TestClient(create_app(settings_for(tmp_path))) as client:
        assert client.get(f"/v1/heightmaps/{heightmap['id']}").json() == heightmap
        assert client.get(f"/v1/costmaps/{costmap['id']}").json() == costmap
        again = client.post(f"/v1/costmaps/{costmap['id']}/paths", json=question).json()
        assert {**again, "details": None} == {**path, "details": None}


def test_a_data_directory_may_be_taken_by_one_process_alone(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'test.db'}"
    services = [Store(tmp_path, url) for _ in range(2)]
    for service in services:
        service.open()
    with pytest.raises(ConflictError, match="another joulemap"):
        Store(tmp_path, url).open(alone=True)
    for service in services:
        service.close()
    alone = Store(tmp_path, url)
    alone.open(alone=True)
    alone.close()


def test_what_killed_processes_left_is_removed_and_what_is_whole_stays(tmp_path: Path) -> None:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'test.db'}")
    store.open()
    store.close()
    whole = [
        tmp_path / "heightmaps" / "hm-0123456789ab.tif",
        tmp_path / "costmaps" / "cm-0123456789ab.zarr" / "zarr.json",
    ]
    left = [
        tmp_path / "uploads" / "0123456789abcdef" / "upload",
        tmp_path / "heightmaps" / "hm-ba9876543210.tif.89ab.partial" / "copied",
        tmp_path / "costmaps" / "cm-ba9876543210.zarr.partial" / "zarr.json",
        tmp_path / "costmaps" / "cm-ba9876543210.zarr.tiles" / "0.json",
        tmp_path / "calibrations" / "cal-0123456789ab.89ab.partial" / "order.json",
    ]
    for path in (*whole, *left):
        path.parent.mkdir(exist_ok=True)
        path.write_text("{}")
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'test.db'}")
    store.open()
    assert [path.exists() for path in whole] == [True, True]
    assert [path.parent.exists() for path in left] == [False] * 5
    store.close()


SERVE = """
import os, sys
from pathlib import Path
from joulemap.service.commands.services import serve
os.environ["JOULEMAP_WARM_MODELS"] = '["physics"]'
serve(port=int(sys.argv[2]), data_dir=Path(sys.argv[1]))
"""


@contextmanager
def serving(
    folder: Path, *, place: str = "/healthz", umask: int = -1, log: Path | None = None, **env: str
) -> Iterator[tuple[subprocess.Popen[bytes], httpx.Client]]:
    """A service in a process of its own that answers at a place, killed in the end, and a client of it."""
    port = free_port()
    command = [sys.executable, "-c", SERVE, str(folder), str(port)]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "JOULEMAP_WORKERS": "1", **env}
    with nullcontext() if log is None else log.open("w") as said:
        process = subprocess.Popen(command, env=env, umask=umask, stderr=said)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=150.0) as http:
            wait_until(
                lambda: process.poll() is not None or answers(http, place), 400.0
            )  # where kernels are compiled first
            yield process, http
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def answers(http: httpx.Client, path: str) -> bool:
    try:
        return http.get(path).status_code == 200
    except httpx.TransportError:
        return False


def wait_until(condition, timeout_s: float = 100.0) -> None:  # type: ignore[no-untyped-def]
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


def ask(http: Any, tif: bytes) -> str:
    """Send a heightmap and ask for a cost map; its place."""
    heightmap = http.post("/v1/heightmaps", content=tif).json()
    return http.post("/v1/costmaps", json={"heightmap_id": heightmap["id"], **PHYSICS}).headers["location"]


def status(http: Any, place: str) -> str:
    return http.get(place).json()["status"]


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_job_that_is_cut_off_is_taken_up_again(tmp_path: Path, hill_tif: bytes, how: signal.Signals) -> None:
    """A real process that ends, one way or the other, while its workers make a cost map."""
    with serving(tmp_path, **disturbed(tile_cells=16, pause_s=0.6)) as (process, http):
        place = ask(http, hill_tif)
        wait_until(lambda: 0.0 < http.get(place).json()["progress"] < 0.8)
        assert status(http, place) == "running"
        refused = http.post(f"{place}/paths", json={"start": START, "goal": GOAL})
        assert (refused.status_code, refused.json()["code"]) == (409, "conflict")
        assert "retry-after" in refused.headers
        process.send_signal(how)
        process.wait(60.0)
        assert list(tmp_path.glob("costmaps/*.tiles/[0-9]*.json"))
    with serving(tmp_path, **disturbed(tile_cells=16)) as (_, http):
        wait_until(lambda: status(http, place) == "done")
        assert http.post(f"{place}/paths", json={"start": START, "goal": GOAL}).status_code == 200
        wait_until(lambda: [p.name for p in (tmp_path / "costmaps").iterdir()] == [f"{place.rsplit('/', 1)[-1]}.zarr"])


def test_who_waits_for_a_job_is_answered_when_the_service_stops(
    tmp_path: Path, hill_tif: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    with serving(tmp_path, **disturbed(tile_cells=16, pause_s=20.0)) as (process, http), ThreadPoolExecutor() as pool:
        place = ask(http, hill_tif)
        body = {"heightmap_id": http.get("/v1/heightmaps").json()["items"][0]["id"], **PHYSICS, "headings": 16}
        events = pool.submit(lambda: http.get(f"{place}/events").text)
        waiting = pool.submit(lambda: http.post("/v1/costmaps", json=body, headers=WAIT))
        wait_until(lambda: http.get("/v1/costmaps").json()["total"] == 2)
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == -signal.SIGTERM
        assert waiting.result().status_code == 202
        assert waiting.result().json()["status"] in ("queued", "running")
        assert events.result().startswith("event: progress")
        assert "event: end" not in events.result()
    assert "Finished server process" in capfd.readouterr().err


def test_a_service_that_stops_while_a_job_is_noted_as_done_leaves_nothing_of_its_making(
    tmp_path: Path, hill_tif: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted, finish = threading.Event(), Store.finish

    def slow(store: Store, job_id: str, summary: dict[str, Any]) -> bool:
        done = finish(store, job_id, summary)
        noted.set()
        time.sleep(0.5)
        return done

    monkeypatch.setattr(Store, "finish", slow)
    with TestClient(create_app(settings_for(tmp_path))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()
        costmap = client.post("/v1/costmaps", json={"heightmap_id": heightmap["id"], **PHYSICS}).json()
        assert noted.wait(100.0)
    assert [path.name for path in (tmp_path / "costmaps").iterdir()] == [f"{costmap['id']}.zarr"]


def test_a_full_disk_is_waited_for_deleting_stops_a_job_and_a_killed_worker_is_replaced(
    tmp_path: Path, hill_tif: bytes
) -> None:
    full = tmp_path / "full"
    full.touch()
    with serving(tmp_path, **disturbed(tile_cells=16, pause_s=0.5, full=full)) as (process, http):
        place = ask(http, hill_tif)
        wait_until(lambda: status(http, place) == "running")
        time.sleep(2.0)
        assert status(http, place) == "running"  # it is not the job's fault
        full.unlink()
        wait_until(lambda: list(tmp_path.glob("costmaps/*.tiles/0.json")))
        assert http.delete(place).status_code == 204
        assert http.get(place).status_code == 404
        after = ask(http, hill_tif)
        name = after.rsplit("/", 1)[-1]
        wait_until(lambda: list(tmp_path.glob(f"costmaps/{name}*.tiles/0.json")))
        for worker in workers_of(process.pid):
            os.kill(worker, signal.SIGKILL)
        wait_until(lambda: status(http, after) == "done")
        wait_until(lambda: [p.name for p in (tmp_path / "costmaps").iterdir()] == [f"{name}.zarr"])


def workers_of(pid: int) -> list[int]:
    """The Dask workers that a service started."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(line.split()[0]) for line in listed.stdout.splitlines() if "spawn_main" in line]


def test_an_error_of_ours_fails_the_job_after_some_tries(tmp_path: Path, hill_tif: bytes) -> None:
    with TestClient(create_app(settings_for(tmp_path, workers=0))) as client:
        place = ask(client, hill_tif)
        assert status(client, place) == "queued"  # nobody works here
    (heightmap,) = (tmp_path / "heightmaps").iterdir()
    heightmap.write_bytes(b"damaged")
    with TestClient(create_app(settings_for(tmp_path))) as client:
        wait_until(lambda: status(client, place) == "failed")
        problem = client.get(place).json()["problem"]
        assert problem["status"] == 503  # its content is not what was kept
        assert problem["request_id"] == place.rsplit("/", 1)[-1]
        wait_until(lambda: not list((tmp_path / "costmaps").iterdir()))
