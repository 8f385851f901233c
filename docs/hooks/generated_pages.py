"""Pages of the site that are made at build time, so that they cannot be stale, and files that live elsewhere."""

from __future__ import annotations

import posixpath
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from http_page import http_page
from mkdocs.structure.files import File
from settings_page import settings_page

ROOT = Path(__file__).resolve().parents[2]

VALIDATION = {
    uri: path
    for uri, path in {
        "records/nulls.md": "model/loop/NULLS.md",
        "records/unseen.md": "model/loop/UNSEEN.md",
        "records/power.md": "model/loop/POWER.md",
    }.items()
    if (ROOT / path).is_file()
}
"""Tables of the calibration's validation, as far as they were written; they are added to the navigation."""

ELSEWHERE = {
    "records/model-card.md": "model/weights/MODEL_CARD.md",
    "records/reproduction.md": "tests/paper/REPRODUCTION.md",
    **VALIDATION,
}
"""Place in the site -> file of the repository. Pages link to the file, so that links work in the repository too."""

_LINK = re.compile(r"(\]\()((?:\.\./)+[^)#\s]+)")


def cli_page() -> str:
    """The reference of the command line, as typer writes it."""
    command = [sys.executable, "-m", "typer", "joulemap.service.cli", "utils", "docs", "--name", "joulemap"]
    text = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    text = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+", "", text)  # their first sentences, cut off in the middle
    return text.replace("# `joulemap`\n", "# Command line\n", 1)


def on_config(config: Any) -> Any:
    """Put the records of the validation into the navigation."""
    records_of(config["nav"]).extend(VALIDATION)
    return config


def records_of(nav: list[Any]) -> list[Any]:
    """The list of records in the navigation."""
    explanation = next(entry["Explanation"] for entry in nav if "Explanation" in entry)
    found: list[Any] = next(entry["Records"] for entry in explanation if isinstance(entry, dict))
    return found


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are generated and the files that live elsewhere."""
    made = {
        "reference/cli.md": cli_page(),
        "reference/http.md": http_page(),
        "reference/settings.md": settings_page(),
    }
    for uri, content in made.items():
        files.append(File.generated(config, uri, content=content))
    for uri, path in ELSEWHERE.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Let links to files of the repository lead to their place in the site."""
    here = posixpath.dirname(page.file.src_uri)
    places = {f"../{path}": uri for uri, path in ELSEWHERE.items()}  # as seen from docs/

    def moved(match: re.Match[str]) -> str:
        uri = places.get(posixpath.normpath(posixpath.join(here, match[2])))
        return match[0] if uri is None else match[1] + posixpath.relpath(uri, here or ".")

    return _LINK.sub(moved, markdown)
