"""Jobs done by plain Dask workers at a scheduler's address, for two services that share a database."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import Any

import pytest
from distributed import Client
from fastapi.testclient import TestClient
from pydantic import ValidationError
from sqlalchemy import create_engine, event
from sqlalchemy.exc import OperationalError

from joulemap.model.errors import JoulemapError, NotFoundError
from joulemap.model.robot import Robot
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cli import app as cli
from joulemap.service.cluster import attendance, connection
from joulemap.service.cluster.address import scheduler_address
from joulemap.service.cluster.attendance import Attendance
from joulemap.service.cluster.connection import connected
from joulemap.service.http.app import create_app
from joulemap.service.jobs.costmaps import make
from joulemap.service.settings import Settings
from joulemap.service.storage.claims import Claims
from joulemap.service.storage.store import Store
from joulemap.service.work.tiles import MapOrder
from tests.service.clusters import ROOT, cluster, dask, free_port, shared_scheduler
from tests.service.conftest import settings_for
from tests.service.preload import disturbed
from tests.service.test_restart import ask, serving, status, wait_until
from tests.service.workers import asked, fingerprint, made_here, postgres_programs, postgres_server, rolling

needs_postgres = pytest.mark.skipif(postgres_programs() is None, reason="PostgreSQL is not installed")


def of_rolling(client: Any) -> str:
    """Ask for a cost map of the rolling ground; its place."""
    tif = write_geotiff(None, rolling(95))
    assert tif is not None
    return ask(client, tif)


def undisturbed(folder: Path) -> str:
    """The fingerprint of the lattice that the service is asked for, made in this process."""
    store = Store(folder, f"sqlite:///{folder / 'alone.db'}")
    store.open()
    heightmap = store.add_heightmap(rolling(95), name="rolling", stats={}).id
    costmap_id = asked(store, heightmap)
    made_here(store, costmap_id, folder)
    made = fingerprint(store.lattice_path(costmap_id))
    store.close()
    return made


def test_plain_dask_workers_do_the_jobs_of_a_service(tmp_path: Path) -> None:
    expected = undisturbed(tmp_path / "alone")
    with cluster(1) as (address, _), TestClient(create_app(settings_for(tmp_path, scheduler=address))) as client:
        place = of_rolling(client)
        wait_until(lambda: status(client, place) == "done")
        assert fingerprint(tmp_path / "costmaps" / f"{place.rsplit('/', 1)[-1]}.zarr") == expected


def test_a_scheduler_that_comes_late_is_waited_for(tmp_path: Path) -> None:
    port = free_port()
    settings = settings_for(tmp_path, scheduler=f"tcp://127.0.0.1:{port}")
    with TestClient(create_app(settings)) as client:
        place = of_rolling(client)
        wait_until(lambda: "no Dask scheduler answers" in (client.app.state.service.jobs.trouble or ""))  # type: ignore[attr-defined]
        assert status(client, place) == "queued"
        with cluster(1, port=port):
            wait_until(lambda: status(client, place) == "done")
            assert client.app.state.service.jobs.trouble is None  # type: ignore[attr-defined]


def test_a_scheduler_without_workers_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the start at once; a worker that goes is missed after a while, here two seconds and not twenty."""
    monkeypatch.setattr(attendance, "ABSENT_S", 2.0)
    with cluster(0) as (address, _), TestClient(create_app(settings_for(tmp_path, scheduler=address))) as client:
        wait_until(lambda: f"workers: the scheduler at {address} has no workers" in client.get("/readyz").text)
        assert client.get("/readyz").status_code == 503
        with dask("worker", address, "--host", "127.0.0.1", "--no-dashboard", "--nthreads", "1", "--no-nanny"):
            wait_until(lambda: client.get("/readyz").status_code == 200)
        wait_until(lambda: "has no workers" in client.get("/readyz").text)


class Scheduler:
    """Answers as a script has it: workers, or how it fails."""

    def __init__(self, *answers: dict[str, int] | type[Exception]) -> None:
        self._answers = list(answers)

    async def nthreads(self) -> dict[str, int]:
        answer = self._answers.pop(0)
        if isinstance(answer, type):
            raise answer
        return answer


def test_a_short_absence_of_workers_is_no_trouble() -> None:
    now = 0.0
    one = {"tcp://w": 1}
    client: Any = Scheduler({}, one, {}, TimeoutError, {}, ConnectionError, one)
    looks = Attendance(client, "tcp://s:1", clock=lambda: now)
    found = []
    for now in (0.0, 1.0, 2.0, 20.0, 22.0, 23.0, 24.0):  # noqa: B007  the clock reads it
        found.append(asyncio.run(looks.trouble()))
    none = "the scheduler at tcp://s:1 has no workers: start one, `dask worker tcp://s:1`"
    lost = "the scheduler at tcp://s:1 does not answer within 5 s"
    assert found == [none, None, None, None, none, lost, None]


def test_a_scheduler_that_hangs_is_said_within_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attendance, "ANSWER_S", 0.1)

    class _Hangs:
        async def nthreads(self) -> dict[str, int]:
            await asyncio.sleep(60.0)
            return {}

    client: Any = _Hangs()
    assert asyncio.run(Attendance(client, None).trouble()) == (
        "the service's own scheduler does not answer within 0.1 s"
    )


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("tcp://10.0.0.7:8786", "tcp://10.0.0.7:8786"),
        (" scheduler:8786/ ", "tcp://scheduler:8786"),
        ("TLS://[::1]:1", "tls://[::1]:1"),
        ("127.0.0.1", "write tcp://127.0.0.1:8786"),
        ("tcp://127.0.0.1:0", "no port of 1 to 65535"),
        ("tcp://127.0.0.1:99999", "no port of 1 to 65535"),
        ("tls://host:abc", "write tls://HOST:8786"),
        ("http://host:8786", "write tcp:// or tls://"),
        ("tcp://a b:1", "write tcp://HOST:8786"),
        ("tcp://user@host:1", "write tcp://HOST:8786"),
        ("tcp://host:1/path", "write tcp://HOST:8786"),
        ("tcp://[::1:8786", "write tcp://HOST:8786"),
        ("8786", "write tcp://8786:8786"),
        (":8786", "write tcp://HOST:8786"),
    ],
)
def test_the_address_of_a_scheduler_is_checked(typed: str, meant: str) -> None:
    if meant.startswith("t"):
        assert scheduler_address(typed) == Settings(scheduler=typed).scheduler == meant
        return
    with pytest.raises(ValueError, match=re.escape(meant)) as found:
        scheduler_address(typed)
    assert typed in str(found.value)
    with pytest.raises(ValidationError, match=re.escape(meant)):
        Settings(scheduler=typed)


def test_an_empty_address_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOULEMAP_SCHEDULER", "")
    assert Settings().scheduler is None


@pytest.mark.parametrize("command", ["costmap", "calibrate"])
def test_commands_say_what_is_wrong_with_a_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """A port at which something else answers, or hangs, and an address that is none."""
    monkeypatch.setattr(connection, "CONNECT_S", 1.0)
    write_geotiff(tmp_path / "dem.tif", rolling(20))
    place, out = str(tmp_path / "dem.tif"), str(tmp_path / "out.zarr")
    words = {
        "costmap": ["costmap", place, "--model", "physics", "--out", out],
        "calibrate": ["calibrate", "--heightmap", place, "--runs", place, "--out", out],
    }[command]
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        for typed, code, said in (
            (address, 8, f"no Dask scheduler answers at tcp://{address} within 1 s: start one with `dask scheduler`"),
            ("127.0.0.1", 2, "has no port of 1 to 65535"),
            ("tls://127.0.0.1:1", 3, "wants certificates: name them with DASK_DISTRIBUTED__COMM__TLS__CA_FILE"),
        ):
            began = time.monotonic()
            with pytest.raises(SystemExit) as ended:
                cli([*words, "--scheduler", typed])
            assert (ended.value.code, time.monotonic() - began < 30.0) == (code, True)
            assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (tmp_path / "out.zarr.tiles").exists()


def test_what_failed_is_made_again_though_somebody_still_holds_the_error(tmp_path: Path) -> None:
    """Dask would answer with the error of the first try as long as its future is known by name."""
    ground = tmp_path / "ground.tif"
    order = MapOrder(tmp_path / "map.zarr", ground, {}, Robot().as_dict(), "physics", 1.0, 8)
    order.folder.begin()
    shares: list[float] = []

    async def _report(share: float) -> None:
        shares.append(share)

    async def _make(client: Client) -> Any:
        return await make(client, order, key="cm-again", report=_report)

    async def _twice() -> dict[str, Any]:
        async with connected(shared_scheduler(), workers=0) as client:
            with pytest.raises(JoulemapError) as held:
                await _make(client)
            write_geotiff(ground, rolling(20))
            await asyncio.sleep(0.1)  # what is let go is let go by the loop
            made = await _make(client)
            del held
            return made

    assert asyncio.run(_twice())["frame"]["rows"] == 20
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] < 1.0


@pytest.mark.slow
@needs_postgres
def test_two_services_and_two_workers_of_which_half_is_killed(tmp_path: Path) -> None:
    """The service that sent the job off, the scheduler and a worker are killed one after another."""
    expected = undisturbed(tmp_path / "alone")
    slow = disturbed(pause_s=1.0)
    port = free_port()
    with postgres_server(free_port()) as server, ExitStack() as stack:
        address, workers = stack.enter_context(cluster(2, port=port, **slow))
        shared = {"JOULEMAP_SCHEDULER": address, "JOULEMAP_DATABASE_URL": server.url}
        _, survivor = stack.enter_context(serving(tmp_path, **shared))
        with serving(tmp_path, **shared) as (_, http):
            place = of_rolling(http)
            wait_until(lambda: status(survivor, place) == "running")
        workers[1].send_signal(signal.SIGKILL)  # after the service
        workers[2].send_signal(signal.SIGKILL)
        workers[0].send_signal(signal.SIGKILL)
        for worker in workers:
            worker.wait()
        stack.enter_context(cluster(1, port=port))
        wait_until(lambda: status(survivor, place) == "done")
        assert fingerprint(tmp_path / "costmaps" / f"{place.rsplit('/', 1)[-1]}.zarr") == expected


@needs_postgres
@pytest.mark.slow
def test_a_lost_database_is_told_and_jobs_go_on_when_it_is_back(tmp_path: Path) -> None:
    with ExitStack() as stack:
        server = stack.enter_context(postgres_server(free_port()))
        slow = disturbed(tile_cells=64, pause_s=0.5)
        _, http = stack.enter_context(serving(tmp_path, JOULEMAP_DATABASE_URL=server.url, **slow))
        place = of_rolling(http)
        wait_until(lambda: status(http, place) == "running")
        server.stop()
        refused = http.get(place)
        assert (refused.status_code, refused.json()["code"]) == (503, "busy"), refused.text
        assert "retry-after" in refused.headers
        time.sleep(5.0)  # several looks of the service
        server.start()
        wait_until(lambda: status(http, place) == "done")


@pytest.mark.parametrize("database", ["sqlite", pytest.param("postgresql", marks=[needs_postgres, pytest.mark.slow])])
def test_a_job_is_claimed_once_and_given_back_by_a_process_that_ends(tmp_path: Path, database: str) -> None:
    with postgres_server(free_port()) if database == "postgresql" else nullcontext() as server:
        url = server.url if server else f"sqlite:///{tmp_path / 'a.db'}"
        code = (
            "import sys; from pathlib import Path; from sqlalchemy import create_engine\n"
            "from joulemap.service.storage.claims import Claims\n"
            "claims = Claims(create_engine(sys.argv[1]), Path(sys.argv[2]))\n"
            "print(sorted(claims.keep(['cm-01', 'cm-02'])), flush=True)\n"
            "sys.stdin.read()"
        )
        claims = Claims(create_engine(url), tmp_path / "claims")
        command = [sys.executable, "-c", code, url, str(tmp_path / "claims")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": {**os.environ, "PYTHONPATH": str(ROOT)}}
        with subprocess.Popen(command, text=True, **pipes) as other:  # type: ignore[call-overload]
            assert other.stdout.readline() == "['cm-01', 'cm-02']\n"
            assert claims.keep(["cm-02", "cm-03"]) == {"cm-03"}
            other.send_signal(signal.SIGKILL)
        wait_until(lambda: claims.keep(["cm-02", "cm-03"]) == {"cm-02", "cm-03"})
        assert claims.keep([]) == set()
        claims.close()


@needs_postgres
@pytest.mark.slow
def test_a_database_that_hangs_is_told_within_its_time_and_then_at_once(tmp_path: Path) -> None:
    """All its processes are stopped: their connections stay open, and their system acknowledges what is sent."""
    with ExitStack() as stack:
        server = stack.enter_context(postgres_server(free_port()))
        _, http = stack.enter_context(serving(tmp_path, JOULEMAP_DATABASE_URL=server.url, JOULEMAP_WORKERS="0"))
        wait_until(lambda: http.get("/readyz").status_code == 200)
        with server.frozen():
            began = time.monotonic()
            refused = http.get("/v1/costmaps", timeout=60.0)
            assert (refused.status_code, time.monotonic() - began < 20.0) == (503, True), refused.text
            assert (refused.json()["code"], refused.headers["retry-after"]) == ("busy", "5")
            wait_until(lambda: "database" in http.get("/readyz").json().get("detail", ""))
            for path in ("/v1/costmaps", "/v1/runs", "/v1/heightmaps/hm-000000000000", "/metrics"):
                began = time.monotonic()
                assert (http.get(path).status_code, time.monotonic() - began < 1.0) == (503, True), path
            assert http.get("/healthz").status_code == 200
        wait_until(lambda: http.get("/v1/costmaps").status_code == 200, timeout_s=20.0)
        wait_until(lambda: http.get("/readyz").status_code == 200, timeout_s=20.0)


@pytest.mark.parametrize("database", ["sqlite", pytest.param("postgresql", marks=[needs_postgres, pytest.mark.slow])])
def test_an_id_with_a_null_character_is_not_there_and_no_database_is_asked(tmp_path: Path, database: str) -> None:
    """PostgreSQL refuses such a text in whatever is asked; that was an internal error."""
    with postgres_server(free_port()) if database == "postgresql" else nullcontext() as server:
        store = Store(tmp_path, server.url if server else f"sqlite:///{tmp_path / 'a.db'}")
        store.open()
        asked_for: list[str] = []
        event.listen(
            store.engine, "before_cursor_execute", lambda _c, _k, _s, values, *_: asked_for.append(str(values))
        )
        for ask_for in (store.costmap, store.heightmap, store.runs, store.calibration, store.delete_costmap):
            with pytest.raises(NotFoundError):
                ask_for("cm-\0")
        assert asked_for == []
        store.close()


def deaf_postgres(server: socket.socket) -> None:
    """Let everybody in who connects, as PostgreSQL's protocol has it, and answer nothing that is asked then."""
    held = []
    with suppress(OSError):  # the test ends
        while True:
            client, _ = server.accept()
            held.append(client)
            while True:
                (size,) = struct.unpack(">i", client.recv(4))
                (code,) = struct.unpack(">i", client.recv(size - 4)[:4])
                if code == 3 << 16:  # the version of the protocol; what comes before asks for encryption
                    break
                client.sendall(b"N")
            client.sendall(b"R" + struct.pack(">ii", 8, 0) + b"Z" + struct.pack(">i", 5) + b"I")


def test_a_question_to_a_database_that_hangs_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("psycopg")
    monkeypatch.setattr("joulemap.service.storage.postgres.ANSWER_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        threading.Thread(target=deaf_postgres, args=(deaf,), daemon=True).start()
        store = Store(tmp_path, f"postgresql+psycopg://a:b@127.0.0.1:{deaf.getsockname()[1]}/c")
        began = time.monotonic()
        with pytest.raises(OperationalError, match=r"nothing within 0\.5 s"):
            store.open()
        assert time.monotonic() - began < 5.0
        store.close()


def test_a_database_that_accepts_and_never_answers_is_given_up(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        store = Store(tmp_path, f"postgresql+psycopg://a:b@127.0.0.1:{silent.getsockname()[1]}/c")
        with pytest.raises(OperationalError):
            store.open()
        store.close()
