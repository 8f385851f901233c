"""What is kept survives a restart, and a cost map cut off by a kill is made after it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient

from model.errors import BusyError, ConflictError
from service.app import create_app
from service.jobs import CostmapJobs, JobStopped
from service.store import Store
from tests.service.conftest import GOAL, START, hill, settings_for


def test_everything_survives_a_restart(tmp_path: Path, hill_tif: bytes) -> None:
    question = {"start": START, "goal": GOAL}
    with TestClient(create_app(settings_for(tmp_path))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()
        costmap = client.post(
            "/v1/costmaps", json={"heightmap_id": heightmap["id"], "model": "physics"}, headers={"Prefer": "wait=60"}
        ).json()
        path = client.post(f"/v1/costmaps/{costmap['id']}/paths", json=question).json()
    with TestClient(create_app(settings_for(tmp_path))) as client:
        assert client.get(f"/v1/heightmaps/{heightmap['id']}").json() == heightmap
        assert client.get(f"/v1/costmaps/{costmap['id']}").json() == costmap
        again = client.post(f"/v1/costmaps/{costmap['id']}/paths", json=question).json()
        assert {**again, "details": None} == {**path, "details": None}


def test_a_data_directory_has_one_service(tmp_path: Path) -> None:
    with (
        TestClient(create_app(settings_for(tmp_path))),
        pytest.raises(ConflictError, match="another joulemap service"),
        TestClient(create_app(settings_for(tmp_path))),
    ):
        pass


SERVE = """
import sys, time
import uvicorn
from pathlib import Path
from planner import lattice_build
from service.app import create_app
from service.settings import Settings
if sys.argv[2] == "slow":  # every strip of the lattice takes a while, so that the kill comes in the middle
    import service.workflows as workflows
    build = workflows.build_lattice
    def slow(*args, progress, **kwargs):
        def report(share):
            progress(share)
            time.sleep(60)
        return build(*args, strip_rows=4, progress=report, **kwargs)
    workflows.build_lattice = slow
settings = Settings(data_dir=Path(sys.argv[1]), warm_models=("physics",))
uvicorn.run(create_app(settings), host="127.0.0.1", port=int(sys.argv[3]), log_level="warning")
"""


def free_port() -> int:
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def test_a_killed_job_is_taken_up_again(tmp_path: Path, hill_tif: bytes) -> None:
    """A real process, killed without warning while it makes a cost map."""
    port = free_port()
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    process = subprocess.Popen([sys.executable, "-c", SERVE, str(tmp_path), "slow", str(port)], env=env)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0) as http:
            wait_until(lambda: answers(http, "/healthz"))
            heightmap = http.post("/v1/heightmaps", content=hill_tif).json()
            asked = {"heightmap_id": heightmap["id"], "model": "physics"}
            first = http.post("/v1/costmaps", json=asked).json()
            second = http.post("/v1/costmaps", json=asked).json()
            wait_until(lambda: http.get(f"/v1/costmaps/{first['id']}").json()["progress"] > 0)
            assert http.get(f"/v1/costmaps/{second['id']}").json()["status"] == "queued"
            refused = http.post(f"/v1/costmaps/{first['id']}/paths", json={"start": START, "goal": GOAL})
            assert (refused.status_code, refused.json()["code"]) == (409, "conflict")
            assert "retry-after" in refused.headers
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    with TestClient(create_app(settings_for(tmp_path))) as client:
        for costmap_id in (first["id"], second["id"]):
            place = f"/v1/costmaps/{costmap_id}"
            wait_until(lambda place=place: client.get(place).json()["status"] == "done")
            answer = client.post(f"{place}/paths", json={"start": START, "goal": GOAL})
            assert answer.status_code == 200, answer.text


def answers(http: httpx.Client, path: str) -> bool:
    try:
        return http.get(path).status_code == 200
    except httpx.TransportError:
        return False


def wait_until(condition, timeout_s: float = 60.0) -> None:  # type: ignore[no-untyped-def]
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


@pytest.fixture
def store(tmp_path: Path):  # type: ignore[no-untyped-def]
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'test.db'}")
    store.open()
    yield store
    store.close()


def entered(store: Store) -> str:
    heightmap = store.add_heightmap(hill(), name="hill", stats={})
    return store.add_costmap(heightmap.id, {}).id


def test_a_failed_job_keeps_its_problem_and_a_stop_keeps_the_job(store: Store) -> None:
    def build(_costmap_id: str, _progress: object) -> None:
        raise ZeroDivisionError("a detail for the log only")

    jobs = CostmapJobs(store, build, queue_size=1)
    failed = entered(store)
    jobs.submit(failed)
    wait_until(lambda: store.costmap(failed).status == "failed")
    problem = store.costmap(failed).problem
    assert problem is not None
    assert (problem["status"], problem["request_id"]) == (500, failed)
    assert "log only" not in str(problem)

    running, go_on = threading.Event(), threading.Event()

    def long_build(_costmap_id: str, progress) -> None:  # type: ignore[no-untyped-def]
        running.set()
        go_on.wait(10)
        progress(0.5)
        pytest.fail("a stopped job went on")

    jobs = CostmapJobs(store, long_build, queue_size=1)
    cut = entered(store)
    jobs.submit(cut)
    assert running.wait(10)
    with pytest.raises(BusyError):
        jobs.check_room()
    threading.Timer(0.1, go_on.set).start()
    jobs.stop()
    assert store.unfinished() == [cut]


def test_deleting_stops_the_job(store: Store) -> None:
    seen: list[BaseException] = []
    running, go_on = threading.Event(), threading.Event()

    def build(_costmap_id: str, progress) -> None:  # type: ignore[no-untyped-def]
        running.set()
        go_on.wait(10)
        try:
            progress(0.5)
        except JobStopped as stopped:
            seen.append(stopped)
            raise

    jobs = CostmapJobs(store, build, queue_size=2)
    first, second = entered(store), entered(store)
    jobs.submit(first)
    jobs.submit(second)
    assert running.wait(10)
    for costmap_id in (second, first):
        store.delete_costmap(costmap_id)
        jobs.forget(costmap_id)
    go_on.set()
    jobs.stop()
    assert len(seen) == 1
    assert store.costmaps(limit=10, offset=0) == ([], 0)
