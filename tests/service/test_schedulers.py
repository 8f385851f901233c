"""Schedulers that have no workers, hang, or are none: what `/readyz` and the commands say of them."""

from __future__ import annotations

import asyncio
import re
import socket
import time
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from pydantic import ValidationError

from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cli import app as cli
from joulemap.service.cluster import connection
from joulemap.service.cluster.address import scheduler_address
from joulemap.service.cluster.connection import Attendance
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.app import create_app
from tests.service.clusters import cluster, dask
from tests.service.conftest import settings_for
from tests.service.test_restart import wait_until
from tests.service.workers import rolling


def test_a_scheduler_without_workers_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the start at once; a worker that goes is missed after a while, here two seconds and not twenty."""
    monkeypatch.setattr(connection, "ABSENT_S", 2.0)
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
    monkeypatch.setattr(connection, "ANSWER_S", 0.1)

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


def test_an_error_of_the_watch_is_said_and_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def _fail(_attendance: Attendance) -> None:
        raise ValueError("nobody expects this")

    monkeypatch.setattr(Attendance, "trouble", _fail)
    with cluster(0) as (address, _), TestClient(create_app(settings_for(tmp_path, scheduler=address))) as client:
        wait_until(lambda: "the workers do not start: see the log" in client.get("/readyz").text)


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
