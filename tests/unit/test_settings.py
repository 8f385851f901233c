"""Settings: where a service keeps its data, and what cannot be used is refused in words that name it."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from joulemap.service.cli import app
from joulemap.service.hosting.settings import Settings


@pytest.mark.parametrize(
    ("given", "folder"),
    [
        ("/srv/joulemap", "/srv/joulemap"),
        ("file:///srv/joulemap", "/srv/joulemap"),
        ("file:/srv/joulemap", "/srv/joulemap"),
        (Path("file:///srv/joulemap"), "/srv/joulemap"),
        ("file:///srv/our%20maps", "/srv/our maps"),
        ("data", "data"),
    ],
)
def test_the_data_folder_is_a_path_or_a_url(given, folder) -> None:
    assert Settings(data_dir=given).data_dir == Path(folder)


def test_another_kind_of_url_is_refused() -> None:
    with pytest.raises(ValidationError, match="s3:"):
        Settings(data_dir="s3://bucket/joulemap")


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
    ("url", "attribution", "words"),
    [
        ("https://{s}.tiles.example/{z}/{x}/{y}.png", "© us", "should match pattern"),
        ("https://tiles.example/{z}/{x}/{y}{r}.png", "© us", "{r} is filled with nothing"),
        ("https://tiles.example:99999/{z}/{x}/{y}.png", "© us", "Port out of range"),
        ("https://tiles.example/{z}/{x}.png", "© us", "it lacks {y}: write `https://HOST/{z}/{x}/{y}.png`"),
        ("https://tiles.example/{z}/{x}/{y}.png", " ", "JOULEMAP_BASEMAP_ATTRIBUTION is ' ': write whose"),
        ("https://tiles.example; script-src */{z}/{x}/{y}.png", "© us", "should match pattern"),
    ],
)
def test_serve_says_what_is_wrong_with_the_base_map(
    url: str,
    attribution: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("JOULEMAP_BASEMAP_URL", url)
    monkeypatch.setenv("JOULEMAP_BASEMAP_ATTRIBUTION", attribution)
    with pytest.raises(SystemExit) as ended:
        app(["serve", "--data-dir", str(tmp_path)])
    assert ended.value.code == 2
    assert words in " ".join(capsys.readouterr().err.replace("│", " ").split())


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
