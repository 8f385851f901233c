"""The site builds without a warning, works offline, and its reference is complete."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import fields
from html import unescape
from pathlib import Path

import pytest
import yaml

import joulemap
from joulemap.model.robot import Robot
from joulemap.service.hosting.settings import Settings
from tests.docs.code_blocks import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"?([^\">\s]+)", text)
        loaded += re.findall(r"<link[^>]*\shref=\"?([^\">\s]+)", text)
        assert loaded
        assert not [url for url in loaded if re.match(r"(https?:)?//", url)], page


def test_every_command_and_option_is_on_the_page_of_the_command_line(site: Path) -> None:
    from joulemap.service.cli import app

    text = (site / "reference/cli.html").read_text(encoding="utf-8")
    names = [info.name or info.callback.__name__.replace("_", "-") for info in app.registered_commands if info.callback]
    assert len(names) > 10
    for name in names:
        assert f"joulemap {name}</code>" in text, name
    assert all(
        option in text for option in ("--robot", "--spacing", "--neighbours", "--alternatives", "--baseline-runs")
    )


def test_every_endpoint_and_field_is_on_the_page_of_http(site: Path) -> None:
    from joulemap.service.http.app import openapi_document

    text = unescape((site / "reference/http.html").read_text(encoding="utf-8"))
    document = openapi_document()
    for path, methods in document["paths"].items():
        assert all(f"{method.upper()} {path}</code>" in text for method in methods), path
    for name, schema in document["components"]["schemas"].items():
        assert f'id="{name.lower()}"' in text, name
        assert all(f"<code>{key}</code>" in text for key in schema.get("properties", ())), name


def test_every_public_name_is_on_the_page_of_python(site: Path) -> None:
    text = (site / "reference/python.html").read_text(encoding="utf-8")
    assert not [name for name in joulemap.__all__ if f'id="joulemap.{name}"' not in text]


def test_every_setting_is_on_the_page_of_settings(site: Path) -> None:
    text = (site / "reference/settings.html").read_text(encoding="utf-8")
    assert not [name for name in Settings.model_fields if f"JOULEMAP_{name.upper()}" not in text]


def test_the_table_of_the_robot_file_has_every_key_and_its_default() -> None:
    page = (ROOT / "docs/reference/files.md").read_text(encoding="utf-8")
    table = page.partition("## Robot file")[2].partition("## ")[0]
    said: dict[str, str] = {}
    for line in (line for line in table.splitlines() if line.startswith("| `")):
        names, _, _, default, *_ = (cell.strip() for cell in line.split("|")[1:6])
        keys = re.findall(r"`(\w+)`", names)
        said |= dict(zip(keys, default.replace("`", "").split(", "), strict=False))
    for field in fields(Robot):
        value = getattr(Robot(), field.name)
        assert field.name in said, field.name
        assert said[field.name] == value if isinstance(value, str) else float(said[field.name]) == value, field.name


def test_the_table_of_exit_codes_is_that_of_the_program() -> None:
    from joulemap.service.problems import INTERNAL_EXIT_CODE, TABLE

    page = (ROOT / "docs/reference/index.md").read_text(encoding="utf-8")
    said = {int(row[0]): row[1] for row in re.findall(r"^\| (\d+) \|.*\| (\d*) \|$", page, re.MULTILINE)}
    assert {row.exit_code: str(row.status) for row in TABLE.values()}.items() <= said.items()
    assert said[INTERNAL_EXIT_CODE] == "500"


def test_the_citation_is_of_this_version() -> None:
    from importlib.metadata import version

    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0"
    assert cited["version"] == version("joulemap")
    assert {"title", "message", "authors", "type"} <= set(cited)
    assert "Uneven Terrains" in cited["references"][0]["title"]


def test_the_readme_is_short_and_leads_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert text.count("\n") < 200
    links = re.findall(r"\]\(([^)#]+)", text + (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert len(links) > 20
    assert not [link for link in links if not link.startswith("http") and not (ROOT / link).exists()]
