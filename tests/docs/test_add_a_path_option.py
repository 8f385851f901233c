"""docs/how-to/add-a-path-option.md: its two files are changed as it says, and every face has the option."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.code_blocks import ROOT, blocks_of

PAGE = "docs/how-to/add-a-path-option.md"
_TRY = """
import contextlib, importlib, inspect, io, json, sys, types
for file, text in json.load(sys.stdin).items():
    name = "joulemap." + file.removesuffix(".py").replace("/", ".")
    parent, _, short = name.rpartition(".")
    module = types.ModuleType(name)
    module.__package__, module.__file__ = parent, file
    sys.modules[name] = module
    setattr(importlib.import_module(parent), short, module)
    exec(compile(text, file, "exec"), module.__dict__)

import numpy as np, joulemap as jm
from typer.testing import CliRunner
from joulemap.service.cli import app
from joulemap.service.client import ServedCostMap
from joulemap.service.http.app import openapi_document

costs = jm.costmap(jm.heightmap(np.zeros((12, 12)), resolution_m=1.0), model="physics")
costs.save("flat.zarr")
asked = ["path", "flat.zarr", "--start", "2,2", "--goal", "10,2"]
def refused(**how):
    try:
        costs.plan((2.0, 2.0), (10.0, 2.0), **how)
    except jm.JoulemapError as error:
        return error.message
runs = [CliRunner().invoke(app, [*asked, *more]) for more in ((), ("--longest", "7"), ("--longest", "9"))]
print(json.dumps({
    "help": CliRunner().invoke(app, ["path", "--help"], env={"COLUMNS": "200"}).stdout,
    "codes": [run.exit_code for run in runs],
    "message": runs[1].stderr,
    "library": [refused(), refused(longest_m=7.0), refused(longest_m=9.0)],
    "signatures": [str(inspect.signature(of.plan)) for of in (jm.CostMap, ServedCostMap)],
    "words": [of.plan.__doc__ for of in (jm.CostMap, ServedCostMap)],
    "http": openapi_document()["components"]["schemas"]["PathRequest"]["properties"]["longest_m"],
}))
"""


def changed_files() -> dict[str, str]:
    """Sources with the page's lines added, by file."""
    files: dict[str, str] = {}
    for block in blocks_of(PAGE):
        if block.language == "diff":
            lines = block.text.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] == " ")
            after = "".join(line[1:] for line in lines)
            text = files.get(block.title) or (ROOT / block.title).read_text(encoding="utf-8")
            assert text.count(before) == 1, f"{block}: {before}"
            files[block.title] = text.replace(before, after)
    return files


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    command, folder = [sys.executable, "-c", _TRY], tmp_path_factory.mktemp("option")
    done = subprocess.run(command, input=json.dumps(changed_files()), cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_two_files_are_changed() -> None:
    assert list(changed_files()) == ["service/questions/path.py", "planner/route_planner.py"]


def test_every_face_has_the_option(found: dict[str, object]) -> None:
    assert "--longest" in str(found["help"])
    assert "Refuse a path longer than this [m]." in str(found["help"])
    assert all("longest_m: 'float | None' = None" in one for one in found["signatures"])  # type: ignore[attr-defined]
    assert all("Refuse a path longer than this [m]." in one for one in found["words"])  # type: ignore[attr-defined]
    assert found["http"]["description"] == "refuse a path longer than this [m]"  # type: ignore[index]


def test_it_reaches_the_planner(found: dict[str, object]) -> None:
    message = "the best route is 8 m long, and `longest_m` is 7"
    assert found["library"] == [None, message, None]
    assert found["codes"] == [0, 4, 0]
    assert "the best route is 8 m long, and --longest is 7" in str(found["message"])


def test_the_page_is_found() -> None:
    assert Path(PAGE).name in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
