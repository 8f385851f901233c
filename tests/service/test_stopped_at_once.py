"""A service that is stopped while its kernels load ends them first: nothing is read of a folder that is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.clusters import free_port
from tests.service.test_restart import wait_until

SERVE = """
import sys, time
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.cli import app

plan, begin = StoredPlanner.plan, StoredPlanner.__init__

def begun(self, path):
    self.path = path
    begin(self, path)

def again_and_again(self, *ends):
    print("the map is there", flush=True)
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        plan(StoredPlanner(self.path), *ends)

StoredPlanner.__init__, StoredPlanner.plan = begun, again_and_again
app(["serve", "--port", sys.argv[1], "--data-dir", sys.argv[2]])
"""
"""The service, which reads its map of the warm-up for longer."""


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_no_damaged_map_is_said(tmp_path: Path, how: signal.Signals) -> None:
    log = tmp_path / "log"
    command = [sys.executable, "-c", SERVE, str(free_port()), str(tmp_path / "data")]
    env = {**os.environ, "JOULEMAP_WORKERS": "0", "JOULEMAP_WARM_MODELS": "[]"}
    with log.open("w") as said, subprocess.Popen(command, env=env, stdout=said, stderr=said) as process:
        try:
            wait_until(lambda: process.poll() is not None or "the map is there" in log.read_text(), 400.0)
            assert process.poll() is None, log.read_text()
            process.send_signal(how)
            process.wait(60.0)
        finally:
            process.kill()
    assert "loading the kernels failed" not in log.read_text()
    assert "Traceback" not in log.read_text()
