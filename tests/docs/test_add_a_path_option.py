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
import importlib, inspect, json, sys, types
for file, text in json.load(sys.stdin).items():
    name = "joulemap." + file.removesuffix(".py").replace("/", ".")
    parent, _, short = name.rpartition(".")
    module = sys.modules[name] = types.ModuleType(name)
    setattr(importlib.import_module(parent), short, module)
    exec(compile(text, file, "exec"), module.__dict__)
import numpy as np, joulemap as jm
from typer.testing import CliRunner
from joulemap.service.cli import app
from joulemap.service.client import ServedCostMap
from joulemap.service.http.app import openapi_document
jm.costmap(jm.heightmap(np.zeros((12, 12)), resolution_m=1.0), model="physics").save("flat.zarr")
asked = ["path", "flat.zarr", "--start", "2,2", "--goal", "10,2", "--longest"]
asks = [*asked, "7"], [*asked, "9"], ["path", "--help"]
refused, found, helped = (CliRunner().invoke(app, words, env={"COLUMNS": "200"}) for words in asks)
shown = [helped.stdout] + [str(inspect.signature(of.plan)) + of.plan.__doc__ for of in (jm.CostMap, ServedCostMap)]
shown += [str(openapi_document()["components"]["schemas"]["PathRequest"]["properties"]["longest_m"])]
print(json.dumps({"shown": shown, "codes": [refused.exit_code, found.exit_code], "message": refused.stderr}))
"""


def changed_files() -> dict[str, str]:
    files: dict[str, str] = {}  # with the page's lines
    for block in blocks_of(PAGE):
        if block.language == "diff":
            lines = block.text.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] == " ")
            text = files.get(block.title) or (ROOT / block.title).read_text(encoding="utf-8")
            assert text.count(before) == 1, f"{block}: {before}"
            files[block.title] = text.replace(before, "".join(line[1:] for line in lines))
    return files


@pytest.mark.slow
def test_two_files_are_changed_and_every_face_has_the_option(tmp_path: Path) -> None:
    assert list(changed_files()) == ["service/questions/path.py", "planner/route_planner.py"]
    run = [sys.executable, "-c", _TRY]
    done = subprocess.run(run, input=json.dumps(changed_files()), cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert ["efuse a path longer than this [m]" in text for text in found["shown"]] == [True] * 4
    assert (found["codes"], "8 m long, and --longest is 7" in found["message"]) == ([4, 0], True)
