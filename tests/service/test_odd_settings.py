"""Settings that cannot be used are refused in words that name them, before anything is started."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from joulemap.service.cli import app
from joulemap.service.settings import Settings


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
