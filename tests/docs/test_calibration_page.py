"""docs/explanation/calibration.md: its table of constants is that of the program, and leaves none out."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.code_blocks import ROOT

PAGE = (ROOT / "docs/explanation/calibration.md").read_text(encoding="utf-8")
TABLE = dict(re.findall(r"^\| `(\w+\.\w+)` \| ([^|]+?) \|", PAGE, re.MULTILINE))
DECIDES = (
    "base_step",
    "design",
    "selection",
    "procedure",
    "residuals",
    "variation",
    "mixed_model",
    "refused_columns",
    "structure",
    "warming_up",
)
"""Modules whose constants decide what is named."""
NO_THRESHOLDS = {"variation._GRID"}
"""Where a search starts, which changes no answer."""


def source_of(name: str) -> Path:
    """File of a module of the loop, of its forms, or of what it shares with training."""
    folders = ("model/loop", "model/loop/forms", "model/runs", "model/energy")
    files = [ROOT / folder / f"{start}{name}.py" for folder in folders for start in ("", "_")]
    return next(path for path in files if path.is_file())


def module_of(name: str) -> str:
    return ".".join(("joulemap", *source_of(name).relative_to(ROOT).with_suffix("").parts))


def numbers_in(source: Path) -> Iterator[str]:
    """Names of module constants that are a number or a tuple of numbers."""
    for node in ast.parse(source.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper():
            try:
                value = ast.literal_eval(node.value)
            except ValueError:
                continue
            if isinstance(value, int | float) or (isinstance(value, tuple) and not any(map(str_like, value))):
                yield node.targets[0].id


def str_like(value: object) -> bool:
    return isinstance(value, str)


@pytest.mark.parametrize("name", TABLE)
def test_a_constant_has_the_value_of_the_program(name: str) -> None:
    module, _, constant = name.partition(".")
    value = getattr(importlib.import_module(module_of(module)), constant)
    said = ast.literal_eval(TABLE[name])
    assert said == value


@pytest.mark.parametrize("module", DECIDES)
def test_no_constant_is_left_out(module: str) -> None:
    lacking = {f"{module}.{name}" for name in numbers_in(source_of(module))} - set(TABLE) - NO_THRESHOLDS
    assert not lacking


def test_there_are_few_settings() -> None:
    """At most 25 constants are neither sourced nor derived."""
    kinds = re.findall(r"^\| [^|]+ \| [^|]+ \| (setting|source|derived|numerical)\b", PAGE, re.MULTILINE)
    assert len(kinds) >= len(TABLE)
    assert kinds.count("setting") <= 25


def test_the_procedure_is_short() -> None:
    procedure = PAGE.partition("## The procedure")[2].partition("\n## ")[0]
    assert len(re.findall(r"^\d+\. ", procedure, re.MULTILINE)) == 7
    assert procedure.count("\n") <= 30
