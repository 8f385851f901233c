"""Maps of any size as a user asks: cost map and path by the command line, each in a process of its own.

The largest takes half an hour and 10 GB of disk, so sizes are given: `python -m tests.bench --large 3000 10000`.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from joulemap.model.terrain.writers import write_geotiff
from tests.bench.maps import terrain
from tests.bench.timing import Row, once
from tests.service.test_large_map import MEASURED


def bench_start_up() -> list[Row]:
    """`joulemap costmap` on a map of a few cells, which is nearly all start-up, and on 4000 x 4000 heights."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        times = []
        for side, resolution_m in ((20, 1.0), (1000, 0.25)):
            write_geotiff(Path(folder) / "dem.tif", terrain(side, resolution_m))
            command = ["costmap", f"{folder}/dem.tif", "--out", f"{folder}/map.zarr", "--overwrite"]
            peaks: list[int] = []
            times.append(min(once(lambda: peaks.append(peak_mib(command))) for _ in range(3)))  # noqa: B023
            rows.append((f"{side} x {side}", f"`joulemap costmap`, peak {peaks[-1]} MiB", times[-1], "", None))
        rows.append(("1000 x 1000", "`joulemap costmap` beyond its start-up", times[1] - times[0], "", None))
    return rows


def bench_large(cells: int) -> list[Row]:
    """From corner to corner by the command line, physics model and 1 m cells: seconds, gap and peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        write_geotiff(Path(folder) / "dem.tif", terrain(cells, 1.0))
        made = ["costmap", f"{folder}/dem.tif", "--out", f"{folder}/map.zarr", "--model", "physics"]
        building = once(lambda: peak_mib([*made, "--max-values", str(20 * cells * cells)]))
        ends = [f"{share * cells:.0f},{share * cells:.0f}" for share in (0.01, 0.99)]
        asked = ["path", f"{folder}/map.zarr", "--start", ends[0], "--goal", ends[1], "--snap"]
        peaks: list[int] = []
        took = once(lambda: peaks.append(peak_mib([*asked, "--json", f"{folder}/path.json"])))
        details = json.loads((Path(folder) / "path.json").read_text())["details"]
    words = f"`joulemap path` corner to corner, peak {peaks[0]} MiB, {details['tiles']:,} tiles priced"
    load = f"load {os.getloadavg()[0]:.1f}"
    return [
        (f"{cells} x {cells}", f"{words}, {details['expanded']:,} cells settled, {load}", took, "", None),
        (f"{cells} x {cells}", "`joulemap costmap` with its coarse level", building, "", None),
    ]


def peak_mib(command: list[str]) -> int:
    """Run a command of joulemap in a process of its own; its peak memory [MiB]."""
    done = subprocess.run([sys.executable, "-c", MEASURED, *command], capture_output=True, text=True, check=True)
    return int(re.findall(r"peak (\d+) MiB", done.stdout)[-1])
