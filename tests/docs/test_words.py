"""What a user reads uses the field's usual terms: the project's former private vocabulary is in none of it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.docs.code_blocks import ROOT

WORDS = re.compile(
    r"\b(shadows?|news|bend|doubts?|chance|stands?|told|aside|apart|leans?|witness(?:es)?|near copies|plausible|hollow"
    r"|mends?|as a planner knows it|runs come home)\b",
    re.IGNORECASE,
)
SOURCES = [path for folder in ("model", "planner", "service") for path in sorted((ROOT / folder).rglob("*.py"))]


def found_in(text: str) -> list[str]:
    """Each such word with what is around it."""
    text = " ".join(text.split())
    return [text[max(m.start() - 40, 0) : m.end() + 40] for m in WORDS.finditer(text)]


def raised_texts(source: str) -> Iterator[str]:
    """String literals inside raise statements."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Raise):
            yield from strings_in(node)


def strings_in(tree: ast.AST) -> Iterator[str]:
    """Every string literal, parts of f-strings included, except docstrings, of attributes too."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "CONTRIBUTING.md",
        "CITATION.cff",
        "Makefile",
        *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md")),
    ],
)
def test_pages(page: str) -> None:
    assert not found_in((ROOT / page).read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "page",
    [
        "model/weights/MODEL_CARD.md",
        "tests/paper/REPRODUCTION.md",
        *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "model/loop").glob("*.md")),
    ],
)
def test_records_that_the_site_shows(page: str) -> None:
    assert not found_in((ROOT / page).read_text(encoding="utf-8"))


def test_the_newest_sections_of_the_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = "".join(text.split("\n## ")[1:3])  # what is not released, and the newest version
    assert not found_in(re.sub(r"`[^`\n]*`", "", newest))  # names of files and options, former ones too, are names


def commands() -> list[str]:
    from joulemap.service.cli import app

    return [
        "",
        *(info.name or info.callback.__name__.replace("_", "-") for info in app.registered_commands if info.callback),
    ]


@pytest.mark.parametrize("command", commands())
def test_help_of_every_command(command: str) -> None:
    from joulemap.service.cli import app

    shown = CliRunner().invoke(
        app, [*command.split(), "--help"], env={"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}
    )
    assert shown.exit_code == 0
    assert len(shown.output) > 300
    assert not found_in(re.sub(r"[│╭╮╰╯─]", " ", shown.output))


def test_descriptions_of_http() -> None:
    from joulemap.service.http.app import openapi_document

    texts = list(_descriptions(openapi_document()))
    assert len(texts) > 100
    assert not [words for text in texts for words in found_in(text)]


def _descriptions(node: object) -> Iterator[str]:
    if isinstance(node, dict):
        yield from (node[key] for key in ("description", "summary") if isinstance(node.get(key), str))
        for value in node.values():
            yield from _descriptions(value)
    elif isinstance(node, list):
        for value in node:
            yield from _descriptions(value)


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_messages_and_texts(source: Path) -> None:
    """Strings in raise statements, and every other string of several words: answers, reports, pictures."""
    text = source.read_text(encoding="utf-8")
    texts = [*raised_texts(text), *(words for words in strings_in(ast.parse(text)) if " " in words.strip())]
    assert not sorted({words for one in texts for words in found_in(one)})


WEB = [path for path in sorted((ROOT / "service/web").iterdir()) if path.suffix in (".html", ".js")]
SCRIPT_TEXT = re.compile(r"//[^\n]*|/\*.*?\*/|\"[^\"\n]* [^\"\n]*\"|'[^'\n]* [^'\n]*'|`[^`]* [^`]*`", re.S)
"""Comments of a script, and what it says: literals of several words."""


@pytest.mark.parametrize("page", WEB, ids=lambda path: path.name)
def test_the_page_of_the_service(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    texts = SCRIPT_TEXT.findall(text) if page.suffix == ".js" else [re.sub(r"</?[a-z]+", " ", text)]
    texts = [re.sub(r"\$\{[^}]*\}|`[^`\n]*`" if one.startswith("/") else r"\$\{[^}]*\}", "", one) for one in texts]
    assert not [words for one in texts for words in found_in(one)]


def test_such_a_word_is_found() -> None:
    assert found_in("it leans on a Shadow") == ["it leans on a Shadow"] * 2
    assert not found_in("standard bending, understands `by_chance`")
    assert list(raised_texts("raise E(f'a {x} told', y=1)")) == ["a ", " told"]
