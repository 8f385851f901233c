"""How long `joulemap calibrate` takes, as a whole process, on ten runs of 2,000 samples each."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.timing import Row

RUNS, SAMPLES = 10, 2000
_JOULEMAP = (sys.executable, "-c", "from joulemap.service.cli import main; main()")


def bench_calibration() -> list[Row]:
    """Seconds of one calibration with the shipped network: start-up, reading, tracing, routes, report and page."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _joulemap("simulate", "--out", folder, "--runs", RUNS, "--drive", "waypoints", "--seed", 5)
        for run in folder.glob("run_*.csv"):
            lines = run.read_text().splitlines(keepends=True)
            run.write_text("".join(lines[: SAMPLES + 1]))
        given = ("--heightmap", folder / "dem.tif", "--robot", folder / "robot.toml", "--runs", folder)
        began = time.perf_counter()
        said = _joulemap("calibrate", *given, "--out", folder / "found").splitlines()
        took = time.perf_counter() - began
    load = f"load of the machine {os.getloadavg()[0]:.1f}"
    return [(f"{RUNS} runs", f"calibrate: {said[0]}; {said[-1]} ({load})", took, "120 s", took / 120.0)]


def _joulemap(command: str, *options: object) -> str:
    return subprocess.run([*_JOULEMAP, command, *map(str, options)], check=True, capture_output=True, text=True).stdout
