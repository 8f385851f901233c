"""What a robot's own computer needs: `python -m tests.bench.on_robot [--side 1000]`.

A saved cost map is opened, a route is planned and a drive is followed, in a process of its own on one core. Printed are
the seconds until each step is done, those of the processor up to then, and the memory in use. Kernels of numba are
compiled before, as `joulemap warmup` does once.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

HEAVY = ("torch", "fastapi", "starlette", "uvicorn", "dask", "distributed", "sqlalchemy", "matplotlib")
"""What only a service or a training needs."""

_SCRIPT = """
import json, os, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
began, found = time.monotonic(), []

def done(step):
    memory = next(line for line in open("/proc/self/status") if line.startswith("VmRSS")).split()[1]
    found.append([step, time.monotonic() - began, time.process_time(), int(memory) / 1024.0])

folder, *ends = sys.argv[1:]
x0, y0, x1, y1 = map(float, ends)
done("Python")
import joulemap as jm
costs = jm.open_costmap(folder)
done("cost map opened")
route = costs.plan((x0, y0), (x1, y1))
done("route planned")
drive = costs.drive(route, battery=jm.Battery(280.0, charge=0.6))
drive.update(0.0, (x0, y0), power_w=60.0)
drive.forecast()
done("first forecast")
for k in range(1, 101):
    x, y = drive.tracking.metres.point(0.3 * k)
    drive.update(float(k), (x, y), power_w=60.0)
    now = drive.forecast()
done("100 updates with forecast")
json.dump({"steps": found, "modules": sorted(sys.modules), "learnt_m": now.learnt_m}, sys.stdout)
"""


def on_one_core(folder: Path, start: tuple[float, float], goal: tuple[float, float]) -> dict[str, Any]:
    """Steps with their seconds, processor seconds and memory [MiB]; the modules that were loaded; the metres learnt."""
    command = [sys.executable, "-c", _SCRIPT, str(folder), *map(str, [*start, *goal])]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return found


def saved_map(folder: Path, side: int) -> Path:
    """A cost map of hills, a metre a cell."""
    import joulemap as jm

    x, y = np.meshgrid(np.arange(float(side)), np.arange(float(side)))
    ground = jm.heightmap(4.0 * np.sin(x / 60.0) * np.cos(y / 90.0), resolution_m=1.0)
    jm.costmap(ground, model="physics").save(folder / "hills.zarr")
    return folder / "hills.zarr"


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.on_robot", description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=1000, help="cells of a side of the map")
    side = parser.parse_args().side
    with tempfile.TemporaryDirectory() as folder:
        ends = (0.1 * side, 0.5 * side), (0.9 * side, 0.52 * side)
        where = saved_map(Path(folder), side)
        on_one_core(where, *ends)  # compiles what is not compiled yet
        found = on_one_core(where, *ends)
    loaded = [name for name in HEAVY if name in found["modules"]]
    print(f"{side} x {side} cells; {platform.machine()}, one core, load {os.getloadavg()[0]:.1f}")
    print(f"loaded of {', '.join(HEAVY)}: {', '.join(loaded) or 'none'}")
    for step, seconds, processor, memory in found["steps"]:
        print(f"{step:28} {seconds:7.2f} s {processor:7.2f} s of the processor {memory:7.0f} MiB")


if __name__ == "__main__":
    main()
