"""A PostgreSQL that hangs, a database that is away, and what one cannot be asked: answers within a time, in words."""

from __future__ import annotations

import socket
import struct
import threading
import time
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import event
from sqlalchemy.exc import OperationalError
from starlette.datastructures import Headers

from joulemap.model.errors import BusyError, NotFoundError
from joulemap.service.http.access import AtOnce, KeyCheck, Keys
from joulemap.service.storage.store import Store
from tests.service.clusters import free_port
from tests.service.conftest import settings_for
from tests.service.test_restart import serving, wait_until
from tests.service.workers import postgres_programs, postgres_server

needs_postgres = pytest.mark.skipif(postgres_programs() is None, reason="PostgreSQL is not installed")


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


def test_requests_that_wait_for_the_keys_of_a_lost_database_fail_together(tmp_path: Path) -> None:
    """Each would wait for the limit of time otherwise, one after another."""
    asked = []

    def _lost() -> Any:
        asked.append(time.monotonic())
        time.sleep(0.3)
        raise OperationalError("select", {}, Exception("nothing within 10 s"))

    store: Any = SimpleNamespace(sessions=_lost)
    keys = Keys(store, settings_for(tmp_path, workers=0))
    failed = []

    async def _ask() -> None:
        with pytest.raises(BusyError, match="the database does not answer"):
            await keys.caller(Headers({}))
        failed.append(time.monotonic())

    async def _all() -> None:
        async with anyio.create_task_group() as group:
            for _ in range(10):
                group.start_soon(_ask)
        await _ask()

    began = time.monotonic()
    anyio.run(_all)
    assert (len(failed), len(asked)) == (11, 2), "one look for ten, and another one for who came later"
    assert failed[-1] - began < 2.0


def test_nothing_waits_for_a_database_that_is_known_to_be_away(tmp_path: Path) -> None:
    away = [True]

    async def _app(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    store: Any = SimpleNamespace(sessions=lambda: pytest.fail("it was asked"))
    checked: Any = KeyCheck(
        _app,
        keys=Keys(store, settings_for(tmp_path, workers=0)),
        answered=AtOnce("connections", 10, "-"),
        away=lambda: away[0],
    )
    client = TestClient(checked)
    refused = client.get("/v1/costmaps")
    assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
    assert refused.json()["detail"] == "the database does not answer"
    assert client.get("/readyz").status_code == 204
