"""Logs in YAML, as `ros2 topic echo` prints messages: a document for each, or one with a list of records inside."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.json_records import DEEPEST, log_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_KEY = re.compile(r"""(["']?)([A-Za-z_/][\w ./-]{0,100})\1:(?: +(.*))?$""")
_BARE_KEY = re.compile(r"([{,] *)(\w+):")
_COMMENT = re.compile(r"\s*(#.*)?$")
_WORDS = {"true": True, "false": False, "null": None, "~": None, "": None, ".nan": None, "''": "", '""': ""}
_LONGEST_INTEGER = 20  # digits


def recognise(head: bytes, name: str) -> bool:
    """Decide by the first lines: each has one key or is an item, and one has nothing behind its key."""
    lines = [line.strip() for line in head.decode("utf-8", "replace").splitlines()[:-1] if not _COMMENT.match(line)]
    keys = [line for line in lines if line != "---" and not line.startswith("- ")]
    return len(lines) > 1 and all(map(_KEY.match, keys)) and any(line.endswith(":") for line in keys)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the documents."""
    lines = [_lines(each) for each in re.split(r"(?m)^---.*$", content_of(source).decode("utf-8", "replace"))]
    found = [_block(each, 0, 0, source.name)[0] for each in lines if each]
    return log_of(found[0] if len(found) == 1 else found, "YAML", source.name, limits)


def _lines(text: str) -> list[tuple[int, str, str]]:
    """(indentation, key, text behind it); the key of an item of a list is empty."""
    found = list[tuple[int, str, str]]()
    for line in text.splitlines():
        rest = line.strip()
        at, dashes = len(line) - len(line.lstrip()), 0
        while (rest + " ").startswith("- ") and dashes < DEEPEST:
            found.append((at, "", ""))
            at, rest, dashes = at + len(rest) - len(rest[1:].lstrip()), rest[1:].lstrip(), dashes + 1
        if key := _KEY.match(rest):
            found.append((at, key[2], key[3] or ""))
        elif dashes:
            found[-1] = (found[-1][0], "", rest)
    return found


def _block(lines: Sequence[tuple[int, str, str]], at: int, depth: int, name: str) -> tuple[Any, int]:
    """What begins at a line, and the first line after it. A list may stand as deep as its key."""
    if depth > DEEPEST:
        raise RunsError.of_run(name, f"its YAML is nested more than {DEEPEST} deep")
    indentation, listed = lines[at][0], not lines[at][1]
    items, fields = list[Any](), dict[str, Any]()
    while at < len(lines) and lines[at][0] >= indentation and (not lines[at][1]) == listed:
        here, key, word = lines[at]
        at, value = at + 1, _value(word)
        after = lines[at][:2] if at < len(lines) else (-1, "")
        if not word and (after[0] > here or (key and after == (here, ""))):
            value, at = _block(lines, at, depth + 1, name)
        items.append(value)
        fields[key] = value
    return items if listed else fields, at


def _value(word: str) -> Any:
    if word.lower() in _WORDS:
        return _WORDS[word.lower()]
    with suppress(ValueError, RecursionError):
        if word[0] in '[{"':  # `{x: .nan, y: 0.5}`
            return json.loads(_BARE_KEY.sub(r'\1"\2":', word.replace(".nan", "NaN")))
        return int(word) if len(word) < _LONGEST_INTEGER else float(word)
    with suppress(ValueError):
        return float(word)
    return word.strip("'\"")
