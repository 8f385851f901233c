"""How often one request goes from folder to folder: `python -m tests.bench.walks [--trace]`.

Every function is counted where it is called first, once. A stay is a run of such calls in one folder, and a return is a
stay in a folder that was left before. Each question is asked once before, so that nothing is loaded meanwhile; calls
that the service makes while nobody asks do not count.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import CO_OPTIMIZED
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from fastapi.testclient import TestClient
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cli import app as commands
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.app import create_app
from tests.service.conftest import GOAL, START, hill

_FOLDER = re.compile(
    rf"{re.escape(str(Path(__file__).resolve().parents[2]))}/(?:joulemap/)?((?:model|planner|service)\b.*)/"
)


class Calls:
    """Sees the calls of the product in this thread, and in all threads that begin after it was made, until `over`."""

    def __init__(self) -> None:
        self.seen: set[CodeType] = set()
        self._found: list[tuple[str, str]] | None = None  # folder, function
        self.over = False
        threading.settrace(self._see)

    def _see(self, frame: FrameType, _event: str, _: object) -> None:
        code, found = frame.f_code, self._found
        if self.over:  # a thread that lives on; the interpreter may end at any time
            sys.settrace(None)
        elif found is not None and code not in self.seen:
            self.seen.add(code)
            folder = _FOLDER.match(code.co_filename)
            if folder and code.co_flags & CO_OPTIMIZED and not code.co_name.startswith("<"):  # no body of a class
                found.append((folder[1], code.co_qualname))

    def first(self, ask: Callable[[], object]) -> list[tuple[str, str]]:
        """The first calls of functions while something is asked."""
        self._found = found = []
        sys.settrace(self._see)
        ask()
        sys.settrace(None)
        self._found = None
        return found


@contextmanager
def questions(folder: Path) -> Iterator[dict[str, Callable[[], Any]]]:
    """What is asked, by name."""
    site = folder / "site"
    CliRunner().invoke(commands, ["simulate", "--out", str(site), "--runs", "3"], catch_exceptions=False)
    settings = Settings(data_dir=folder / "data", warm_models=("physics",), workers=1)
    how: dict[str, Any] = {"robot": site / "robot.toml", "model": "physics", "quick": True}

    def _calibrate() -> None:
        jm.calibrate(site / "dem.tif", str(site / "run_*.csv"), out=tempfile.mkdtemp(dir=folder), **how)

    with TestClient(create_app(settings), base_url="http://localhost") as client:
        sent = client.post("/v1/heightmaps", content=write_geotiff(None, hill())).json()
        asked = {"heightmap_id": sent["id"], "model": "physics"}
        made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=120"}).json()
        ends = {"start": START, "goal": GOAL}
        yield {
            "POST paths": lambda: client.post(f"/v1/costmaps/{made['id']}/paths", json=ends).raise_for_status(),
            "calibrate": _calibrate,
            "heightmap to lattice": lambda: jm.costmap(site / "dem.tif", model="physics"),
        }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.walks", description=__doc__.splitlines()[0])
    parser.add_argument("--trace", action="store_true", help="also say which functions of which folder, in order")
    options, calls = parser.parse_args(), Calls()
    try:
        with tempfile.TemporaryDirectory() as folder, questions(Path(folder)) as asked:
            for name, ask in asked.items():
                ask()
                calls.seen = set()
                calls.first(lambda: time.sleep(3.0))  # what the service repeats is seen, and counts no more
                found = calls.first(ask)
                stays = [(where, [function for _, function in some]) for where, some in groupby(found, itemgetter(0))]
                folders = len({where for where, _ in stays})
                print(f"{name}: {len(stays)} stays in {folders} folders, {len(stays) - folders} returns", flush=True)
                for where, functions in stays if options.trace else ():
                    print(f"  {where}: {', '.join(functions)}")
    finally:
        calls.over = True
        threading.settrace(None)
        sys.settrace(None)


if __name__ == "__main__":
    main()
