"""What an operator meets: killed readers, revoked keys, damaged rows, a newer database, a clock that jumps."""

from __future__ import annotations

import os
import signal
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import anyio
import httpx
import pytest
from fastapi.testclient import TestClient

from joulemap.model.errors import BusyError, ConflictError, DamagedError
from joulemap.service.http.app import create_app
from joulemap.service.http.retention import SWEEP_S, Retention
from joulemap.service.intake.limits import ReadLimits
from joulemap.service.intake.readers import Readers
from joulemap.service.storage.database import check_pages
from joulemap.service.storage.owners import add_key, revoke_keys
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import SCHEMA, HeightmapRow
from tests.service.conftest import hill, settings_for
from tests.service.test_contract import served
from tests.service.test_restart import wait_until

DAY_S = 86_400.0


def test_readers_that_do_not_live_are_busy_and_no_bug(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    readers = Readers(processes=1, queue=4, limits=ReadLimits(5.0, 500.0))
    start = readers._current

    def _dies_at_once(broken: Any = None) -> Any:
        template, control = start(broken)
        os.kill(template.pid, signal.SIGKILL)
        template.wait()
        return template, control

    monkeypatch.setattr(readers, "_current", _dies_at_once)
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    try:
        with pytest.raises(BusyError, match="send the file again"):
            anyio.run(lambda: readers.read("run", path=str(tmp_path / "a.csv"), name="a.csv"))
    finally:
        readers.close()


@pytest.mark.parametrize("said", [b'\n{"result": {"ro', b"\n{", b'{"result": '])
def test_an_answer_that_is_cut_off_is_busy_and_no_bug(monkeypatch: pytest.MonkeyPatch, said: bytes) -> None:
    readers = Readers(processes=1, queue=4, limits=ReadLimits(5.0, 500.0))

    async def _cut(_asked: bytes) -> bytes:
        return said

    monkeypatch.setattr(readers, "_answer", _cut)
    with pytest.raises(BusyError, match="send the file again"):
        anyio.run(lambda: readers.read("run", name="a.csv"))


def test_what_readers_write_lies_where_it_is_swept(
    client: TestClient, hill_tif: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = client.app.state.service  # type: ignore[attr-defined]
    seen: list[Path] = []
    answer = service.readers._answer

    async def _look(asked: bytes) -> Any:
        seen.extend(service.store.uploads.glob("joulemap-*"))
        return await answer(asked)

    monkeypatch.setattr(service.readers, "_answer", _look)
    assert client.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)}).status_code == 201
    assert len(seen) == 1
    assert not seen[0].exists()


def test_the_streams_of_a_revoked_key_end(tmp_path: Path, hill_tif: bytes) -> None:
    app = create_app(settings_for(tmp_path / "data", workers=0))
    with served(app) as url, httpx.Client(base_url=url, timeout=30.0) as http:
        sessions = app.state.service.store.sessions
        key = {"Authorization": f"Bearer {add_key(sessions, 'rover')}"}
        other = {"Authorization": f"Bearer {add_key(sessions, 'other')}"}
        kept = http.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)}, headers=key).json()["id"]
        asked = {"heightmap_id": kept, "model": "physics"}
        job = http.post("/v1/costmaps", json=asked, headers=key).json()["id"]
        with (
            suppress(httpx.RemoteProtocolError),  # it is ended without a last word
            http.stream("GET", f"/v1/costmaps/{job}/events", headers=key) as stream,
        ):
            lines = stream.iter_lines()
            assert next(lines)
            revoke_keys(sessions, "other")
            began = time.monotonic()
            revoke_keys(sessions, "rover")
            for _ in lines:
                assert time.monotonic() - began < 20.0
        assert time.monotonic() - began < 10.0
        assert http.get("/v1", headers=other).status_code == 401


def _sql(folder: Path, *statements: str) -> None:
    with sqlite3.connect(folder / "joulemap.db") as database:
        for statement in statements:
            database.execute(statement)


BROKEN = {
    "text that is no JSON": "stats = '{'",
    "text that is no UTF-8": "stats = cast(x'7b22ff' as text)",
    "no time": "created_at = 'yesterday'",
    "another kind": "stats = '[1]'",
    "no finite number": """stats = replace(stats, '"height_max_m":', '"height_max_m": 1e999, "other":')""",
}


def test_broken_rows_do_not_break_the_list(tmp_path: Path, hill_tif: bytes) -> None:
    with TestClient(create_app(settings_for(tmp_path / "data", workers=0)), raise_server_exceptions=False) as client:
        ids = {
            name: client.post("/v1/heightmaps", files={"file": (name, hill_tif)}, data={"name": name}).json()["id"]
            for name in ("whole", *BROKEN)
        }
        _sql(
            tmp_path / "data",
            *(f"update heightmaps set {change} where name = '{name}'" for name, change in BROKEN.items()),
        )
        listed = client.get("/v1/heightmaps")
        assert listed.status_code == 200, listed.text
        found = {one["id"]: one for one in listed.json()["items"]}
        assert found[ids["whole"]]["name"] == "whole"
        for damage in BROKEN:
            assert "cannot be shown" in found[ids[damage]]["problem"]["detail"], damage
            one = client.get(f"/v1/heightmaps/{ids[damage]}")
            assert (one.status_code, one.json()["code"]) == (409, "conflict"), damage
        client.app.state.service.retention.sweep()  # type: ignore[attr-defined]
        for damage in BROKEN:
            assert client.delete(f"/v1/heightmaps/{ids[damage]}").status_code == 204
        assert client.get("/v1/heightmaps").json()["total"] == 1


def test_a_newer_database_is_refused_and_an_older_one_taken(tmp_path: Path) -> None:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'joulemap.db'}")
    store.open()
    store.close()
    _sql(tmp_path, "drop table schema_version")  # as of before there were versions
    store.open()
    store.close()
    with sqlite3.connect(tmp_path / "joulemap.db") as database:
        assert database.execute("select version from schema_version").fetchall() == [(SCHEMA,)]
    _sql(tmp_path, f"update schema_version set version = {SCHEMA + 1}")
    with pytest.raises(ConflictError, match="newer joulemap"):
        store.open()
    store.close()


def test_damaged_pages_are_found_at_the_start(tmp_path: Path) -> None:
    place = tmp_path / "joulemap.db"
    store = Store(tmp_path, f"sqlite:///{place}")
    store.open()
    with store.sessions.begin() as session:
        for k in range(400):
            stats = {"words": "x" * 500}
            session.add(HeightmapRow(id=f"hm-{k}", created_at=_time(k), name=str(k), stats=stats))
    check_pages(store.engine)
    store.close()
    content = bytearray(place.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = b"\xa5" * 4096
    place.write_bytes(content)
    with pytest.raises(DamagedError, match="joulemap restore"):
        store.open()
    store.close()
    store.open(as_service=False)  # `joulemap check` looks at the rest
    store.close()


def _time(k: int) -> Any:
    import datetime as dt

    return dt.datetime(2026, 1, 1) + dt.timedelta(seconds=k)


class Clocks:
    """A time of day that jumps, and one that does not [s]."""

    def __init__(self) -> None:
        self.day_s, self.boot_s = time.time(), 1000.0

    def pass_by(self, seconds: float) -> None:
        self.day_s, self.boot_s = self.day_s + seconds, self.boot_s + seconds

    def both(self) -> tuple[Callable[[], float], Callable[[], float]]:
        return lambda: self.day_s, lambda: self.boot_s


@pytest.fixture
def aged(tmp_path: Path) -> Iterator[tuple[Callable[[], Retention], Clocks, str]]:
    """Makes what removes unused things after 30 days; its clocks; a heightmap that is kept."""
    settings, clocks = settings_for(tmp_path, workers=0, retention_days=30.0), Clocks()
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'joulemap.db'}")
    store.open()
    kept = store.add_heightmap(hill(), name="hill", stats={}).id
    yield lambda: Retention(settings, store, {}, clocks=clocks.both()), clocks, kept
    store.close()


@pytest.mark.parametrize("jump_days", [400.0, -400.0])
def test_a_clock_that_jumps_removes_nothing(aged: Any, jump_days: float) -> None:
    begin, clocks, kept = aged
    retention = begin()
    clocks.pass_by(60.0)
    clocks.day_s += jump_days * DAY_S
    assert retention.sweep() == []
    clocks.pass_by(SWEEP_S + 1.0)
    assert retention.sweep() == []
    clocks.pass_by(29.0 * DAY_S)
    assert retention.sweep() == []
    clocks.pass_by(2.0 * DAY_S)
    assert retention.sweep() == [kept], "time that really passed counts"


def test_a_wrong_clock_at_the_start_removes_nothing(aged: Any) -> None:
    begin, clocks, _ = aged
    clocks.day_s += 400.0 * DAY_S
    retention = begin()
    assert retention.sweep() == []
    clocks.day_s -= 400.0 * DAY_S  # as a time server sets it, some minutes later
    clocks.pass_by(120.0)
    assert retention.sweep() == []


def test_the_documentation_runs_no_other_script(client: TestClient) -> None:
    answer = client.get("/docs")
    policy = answer.headers["content-security-policy"]
    scripts = next(part for part in policy.split(";") if part.strip().startswith("script-src"))
    assert "'unsafe-inline'" not in scripts
    assert "sha256-" in scripts
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "https://" not in answer.text.replace("https://fastapi.tiangolo.com", "")


def test_a_check_on_a_schedule_tells_of_damage(
    tmp_path: Path, hill_tif: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with TestClient(create_app(settings_for(tmp_path, check_every_h=0.5 / 3600.0))) as client:
        kept = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        caplog.set_level("INFO")
        wait_until(lambda: "check: nothing is wrong" in caplog.text)
        (tmp_path / "heightmaps" / f"{kept}.tif").write_bytes(hill_tif[:-1] + b"x")
        wait_until(lambda: "joulemap_check_findings 1.0" in client.get("/metrics").text)
        assert f"damaged: {kept}" in caplog.text
