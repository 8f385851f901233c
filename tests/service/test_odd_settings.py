"""Settings that cannot be used are refused in words that name them; and what a lost database does to requests."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest
from fastapi.testclient import TestClient
from pydantic import ValidationError
from sqlalchemy.exc import OperationalError
from starlette.datastructures import Headers

from joulemap.model.errors import BusyError
from joulemap.service.cli import app
from joulemap.service.http.access_keys import KeyCheck, Keys
from joulemap.service.settings import Settings
from tests.service.conftest import settings_for


@pytest.mark.parametrize(
    "url",
    ["nonsense", "mysql://a:b@c/d", "postgresql+psycopg://a:b@c:port/d", "postgresql+asyncpg://c/d", "sqlite+x:///a"],
)
def test_a_database_that_is_none_of_ours_is_refused(url: str) -> None:
    with pytest.raises(ValidationError, match=r"write `postgresql\+psycopg://USER:PASSWORD@HOST:5432/NAME`"):
        Settings(database_url=url)


def test_an_empty_database_url_is_none(tmp_path: Path) -> None:
    assert Settings(database_url=" ", data_dir=tmp_path).resolved_database_url == f"sqlite:///{tmp_path}/joulemap.db"


@pytest.mark.parametrize(
    ("setting", "value"),
    [("read_seconds", "inf"), ("key_gb", "nan"), ("retention_days", "inf"), ("workers", "1001"), ("port", "65536")],
)
def test_a_number_that_cannot_be_is_refused(setting: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(f"JOULEMAP_{setting.upper()}", value)
    with pytest.raises(ValidationError, match=setting):
        Settings()


@pytest.mark.parametrize(
    ("url", "code", "words"),
    [
        ("postgresql+psycopg://anna:secret@host:port/x", 2, "is 'postgresql+psycopg://anna:***@host:port/x': write"),
        ("sqlite:////nowhere/at/all.db", 3, "the database sqlite:////nowhere/at/all.db cannot be used: unable to open"),
    ],
)
def test_serve_says_what_is_wrong_with_the_database(
    url: str,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """And keeps its password to itself."""
    monkeypatch.setenv("JOULEMAP_DATABASE_URL", url)
    with pytest.raises(SystemExit) as ended:
        app(["serve", "--data-dir", str(tmp_path)])
    assert ended.value.code == code
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert words in said
    assert "secret" not in said


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
    checked: Any = KeyCheck(_app, keys=Keys(store, settings_for(tmp_path, workers=0)), away=lambda: away[0])
    client = TestClient(checked)
    refused = client.get("/v1/costmaps")
    assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
    assert refused.json()["detail"] == "the database does not answer"
    assert client.get("/readyz").status_code == 204
