"""A large map through the command line, alone in its process: its peak memory and time (`-s` shows them)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from rasterio.windows import Window

from joulemap.planner.lattice.loading import load_lattice

# (`ru_maxrss` of a process begins at that of the process that started it.)
MEASURED = """
import re, sys, time
from pathlib import Path
from joulemap.service.cli import app
began = time.perf_counter()
try:
    app(sys.argv[1:], standalone_mode=False)
finally:
    peak = int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
    print(f"{time.perf_counter() - began:.1f} s, peak {peak:.0f} MiB")
"""


def write_terrain(path: Path, cells: int, resolution_m: float) -> None:
    """Hills with a lake of unknown heights, written band by band of rows."""
    profile = {
        "driver": "GTiff",
        "width": cells,
        "height": cells,
        "count": 1,
        "dtype": "float32",
        "crs": "EPSG:32632",
        "transform": Affine(resolution_m, 0.0, 500_000.0, 0.0, -resolution_m, 5_400_000.0),
        "nodata": float("nan"),
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
        "bigtiff": "if_safer",
    }
    x = np.arange(cells) * resolution_m
    with rasterio.open(path, "w", **profile) as dataset:
        for row in range(0, cells, 256):
            y = np.arange(row, min(row + 256, cells))[:, None] * resolution_m
            heights = 8.0 * np.sin(0.011 * x + 0.004 * y) + 5.0 * np.cos(0.013 * y) + 0.05 * np.sin(1.9 * x + 2.3 * y)
            heights[np.hypot(x - 300.0, y - 200.0) < 60.0] = np.nan
            dataset.write(heights.astype(np.float32), 1, window=Window(0, row, cells, len(y)))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["physics", "default"])
def test_memory_is_bounded_by_the_tile(tmp_path: Path, model: str) -> None:
    """Cells of 1 m over a map of 1 m pixels; JOULEMAP_LARGE_CELLS along a side (4000)."""
    side = int(os.environ.get("JOULEMAP_LARGE_CELLS", "4000"))
    write_terrain(tmp_path / "dem.tif", side, 1.0)
    out = tmp_path / "map.zarr"
    command = [
        "costmap",
        str(tmp_path / "dem.tif"),
        "--model",
        model,
        "--out",
        str(out),
        "--max-values",
        str(16 * side**2),
    ]
    done = subprocess.run([sys.executable, "-c", MEASURED, *command], capture_output=True, text=True, check=True)
    said = done.stdout.strip().splitlines()[-1]
    each = 1e6 * float(said.split()[0]) / side**2
    print(f"\n{side} x {side} cells, 16 headings, {model}: {said}, {each:.2f} us a cell, load {os.getloadavg()[0]:.1f}")
    peak_mib = float(said.split()[-2])
    whole_mib = side * side * 16 * 4 / 2**20 * (2 if model == "default" else 1)
    assert peak_mib < min(2000.0, max(whole_mib, 1000.0))
    if side <= 1000:
        assert load_lattice(out).frame.shape == (side, side)
