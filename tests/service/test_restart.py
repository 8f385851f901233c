"""What is kept survives a restart, and a cost map cut off by a kill is made after it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import delete

from joulemap.model.errors import BusyError, ConflictError
from joulemap.service.http.app import create_app
from joulemap.service.jobs.costmaps import Builder
from joulemap.service.jobs.steps import LEASE_S, Step, Steps
from joulemap.service.jobs.worker import SERVICE, Jobs, Worker
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import COSTMAP, LAY_OUT, StepRow
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
from joulemap.service.http.app import create_app
from joulemap.service.settings import Settings
if sys.argv[2] == "slow":  # every tile takes a while, so that the kill comes in the middle
    import joulemap.service.jobs.costmaps as building
    build = building.build_tile
    def slow(*args):
        time.sleep(60)
        return build(*args)
    building.build_tile = slow
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
            wait_until(lambda: http.get(f"/v1/costmaps/{first['id']}").json()["status"] == "running")
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


class Small(Builder):
    """Steps without kernels: a job of four tiles that notes what was done. fail_at, hold : at this step."""

    def __init__(self, *, fail_at: int = -1, hold: threading.Event | None = None) -> None:
        self.did: list[tuple[str, int]] = []
        self.gone: list[str] = []
        self.fail_at, self.hold, self.began = fail_at, hold, threading.Event()

    def do(self, step: Step, steps: Steps, report: Callable[[float], None] | None = None) -> None:
        self.began.set()
        if self.hold is not None:
            assert self.hold.wait(10)
        if step.number == self.fail_at:
            raise ZeroDivisionError("a detail for the log only")
        self.did.append((step.job_id, step.number))
        if step.last:
            self.results = steps.results(step.job_id)
            self.store.finish(step.job_id, {})
        elif not steps.complete(step, step.number, tiles=4 if step.number == LAY_OUT else 0):
            self.discard(step.job_id)

    def rest(self) -> None: ...

    def discard(self, costmap_id: str) -> None:
        self.gone.append(costmap_id)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'test.db'}")
    store.open()
    yield store
    store.close()


def entered(store: Store) -> str:
    heightmap = store.add_heightmap(hill(), name="hill", stats={})
    return store.add_costmap(heightmap.id, {}).id


def worker_of(store: Store, builder: Small, name: str = SERVICE) -> Worker:
    builder.store = store
    return Worker(store, {COSTMAP: builder}, name=name, ready=lambda: None)


def test_a_job_is_done_step_by_step_and_a_failed_one_keeps_its_problem(store: Store) -> None:
    good = entered(store)
    builder = Small()
    worker = worker_of(store, builder)
    worker.start()
    wait_until(lambda: store.status(good) == "done")
    assert builder.did == [(good, n) for n in range(6)]
    assert builder.results == [0, 1, 2, 3, 4]
    builder.fail_at = 3
    failed, next_one = entered(store), entered(store)
    worker.wake()
    wait_until(lambda: store.status(failed) == "failed")
    problem = store.costmap(failed).problem
    assert problem is not None
    assert (problem["status"], problem["request_id"]) == (500, failed)
    assert "log only" not in str(problem)
    assert builder.gone[0] == failed
    wait_until(lambda: store.status(next_one) == "failed")  # the others are still looked after
    worker.stop()


def test_a_stop_keeps_the_job_for_the_next_start(store: Store) -> None:
    cut = entered(store)
    go_on = threading.Event()
    held = Small(hold=go_on)
    jobs = Jobs(store, [worker_of(store, held)], queue_size=1)
    jobs.resume()
    assert held.began.wait(10)
    with pytest.raises(BusyError):
        jobs.check_room()
    threading.Timer(0.1, go_on.set).start()
    jobs.stop()
    assert store.unfinished() == [cut]
    assert held.did == [(cut, LAY_OUT)]
    after = Small()
    again = Jobs(store, [worker_of(store, after)], queue_size=1)
    again.resume()
    wait_until(lambda: store.status(cut) == "done")
    again.stop()
    assert after.did == [(cut, n) for n in range(1, 6)]  # from where it was


def test_deleting_stops_the_job(store: Store) -> None:
    first, second = entered(store), entered(store)
    go_on = threading.Event()
    builder = Small(hold=go_on)
    worker = worker_of(store, builder)
    worker.start()
    assert builder.began.wait(10)
    for costmap_id in (second, first):
        store.delete_costmap(costmap_id)
    go_on.set()
    worker.stop()
    assert builder.did == [(first, LAY_OUT)]
    assert builder.gone == [first]
    assert store.costmaps(limit=10, offset=0) == ([], 0)


def test_a_step_is_taken_once_and_goes_on_when_its_worker_is_dead(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    costmap_id = entered(store)
    one, other = Steps(store.sessions, "one"), Steps(store.sessions, "other")
    step = one.take()
    assert step == (costmap_id, LAY_OUT, False)
    assert other.take() is None
    assert one.renew(step)
    assert one.complete(step, {"how": "so"}, tiles=2)
    taken = [one.take(), other.take()]
    assert [s.number for s in taken if s is not None] == [1, 2]
    assert one.take() is None  # the last waits for both
    assert one.complete(taken[0], 11)
    assert store.costmap(costmap_id).progress == pytest.approx(1 / 3)
    assert one.take() is None
    now = time.time()
    monkeypatch.setattr("joulemap.service.jobs.steps.time.time", lambda: now + LEASE_S + 1.0)
    assert one.take() == taken[1]  # nothing was heard of the other
    assert not other.renew(taken[1])
    assert one.complete(taken[1], 12)
    assert other.complete(taken[1], 13)  # too late, and no harm
    assert one.take() == (costmap_id, 3, True)
    assert one.results(costmap_id) == [{"how": "so"}, 11, 12]


def test_a_job_of_an_older_version_is_begun_again(store: Store) -> None:
    costmap_id = entered(store)
    steps = Steps(store.sessions, "one")
    with store.sessions.begin() as session:
        session.execute(delete(StepRow))
    assert steps.take() is None
    steps.add_missing()
    assert steps.take() == (costmap_id, LAY_OUT, False)
