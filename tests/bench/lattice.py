"""The cost lattice: how fast, how much of what the machine can do, how near bins come to the continuous function."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch

from joulemap.model.energy.architectures.compact.dense import CompactPredictor
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.frames import heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.build import build_lattice, write_lattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.planner.pricing.integrator import interpolation_matrix
from tests.bench.maps import ROBOT, terrain
from tests.bench.stages import resnet_seconds_per_patch
from tests.bench.timing import Row, once, seconds
from tests.service.test_large_map import MEASURED

HEADINGS = 16
TILED_SIDES = (1000, 4000)
BINS = (8, 16, 32)


def bench_lattice(cells: int, resolution_m: float) -> list[Row]:
    """The default network's lattice of 1 m cells, mean, standard deviation and blocked mask."""
    size = f"{cells} x {cells}"
    heightmap = terrain(cells, resolution_m)
    default = load_predictor("default")
    assert isinstance(default, CompactPredictor)
    took = seconds(lambda: build_lattice(heightmap, ROBOT, default))
    per_patch = resnet_seconds_per_patch(heightmap)
    flops = cells * cells * operations_per_cell(default)
    moved = (
        cells * cells * (4 * resolution_m**-2 + 2 * 4 * HEADINGS + 13)
    )  # heights read; two arrays and limits written
    with tempfile.TemporaryDirectory() as folder:
        write_geotiff(Path(folder) / "dem.tif", heightmap)
        command = ["costmap", f"{folder}/dem.tif", "--out", f"{folder}/map.zarr"]
        done = subprocess.run([sys.executable, "-c", MEASURED, *command], capture_output=True, text=True, check=True)
    peak = re.findall(r"peak \d+ MiB", done.stdout)[-1]
    theirs = per_patch * cells * cells * HEADINGS
    product, triad = flops / matrix_rate(), moved / triad_rate()
    return [
        (
            size,
            f"default network, {HEADINGS} headings, deviation, blocked mask: {theirs / took:,.0f} x ResNet18",
            took,
            f"a 256 x 256 patch per value, {1e3 * per_patch:.0f} ms each",
            took / theirs,
        ),
        (
            size,
            f"{flops / 1e9:.0f} GFLOP of network in it, {100 * product / took:.0f} % of the machine's rate",
            took,
            "torch's matrix product",
            took / product,
        ),
        (
            size,
            f"{moved / 1e9:.2f} GB read and written, {100 * triad / took:.1f} % of the machine's bandwidth",
            took,
            "a triad",
            took / triad,
        ),
        (size, f"`joulemap costmap` in a process of its own, {peak}", np.nan, "", None),
    ]


def operations_per_cell(predictor: CompactPredictor) -> float:
    """Floating-point operations of the network's layers for one cell 1 m from its neighbours, a product and a sum each;
    without what reads and describes the ground."""
    sizes = {name: array.size for name, array in predictor.weights.arrays.items()}
    ground = 16 * sizes["conv0.weight"] + 4 * sizes["conv1.weight"] + sizes["conv2.weight"]
    ground += sizes["hidden.weight"] + sizes["series.weight"]
    layers = ("tracks.weight", "head.weight", "rest.weight", "spread.weight", "series.bias")
    head = sum(sizes[name] for name in layers)
    return 2.0 * (ground + HEADINGS * head)


def matrix_rate() -> float:
    """Operations per second of torch's float32 matrix product, on all its threads."""
    a = torch.randn(2048, 2048)
    return 2 * 2048**3 / seconds(lambda: a @ a, repeats=5)


def triad_rate() -> float:
    """Bytes per second of a = b + s c, arrays far larger than any cache, on all of torch's threads."""
    b, c = torch.randn(32_000_000), torch.randn(32_000_000)
    a = torch.empty_like(b)
    return 3 * 4 * b.numel() / seconds(lambda: torch.add(b, c, alpha=0.5, out=a), repeats=5)


def bench_tiles() -> list[Row]:
    """The tiled way into a folder, heightmaps of 1 m: what a cell costs on a small and on a large map."""
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        for side in (100, *TILED_SIDES):  # the first only warms up
            heightmap = terrain(side, 1.0)
            tiling = Tiling.of(heightmap.frame, spacing_m=1.0, headings=HEADINGS)
            write = partial(write_lattice, Path(folder) / "a.zarr", heightmap, ROBOT, load_predictor("default"), tiling)
            times[side] = once(write)
    each = {side: times[side] / side**2 for side in TILED_SIDES}
    small = TILED_SIDES[0]
    return [
        (
            f"{side} x {side}",
            f"written tile by tile from a map of 1 m, {1e6 * each[side]:.2f} us a cell",
            times[side],
            f"a cell of {small} x {small}",
            each[side] / each[small],
        )
        for side in TILED_SIDES
    ]


def bench_bins(resolution_m: float) -> list[Row]:
    """Prices at random headings, interpolated between K bins, beside those the model gives at the very headings."""
    rows: list[Row] = []
    heightmap = terrain(60, resolution_m)
    frame = heightmap.frame.respaced(1.0)
    asked = np.sort(np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 90))
    for name in ("physics", "default"):
        model = load_predictor(name)
        true = prices(model.traction_per_m(heightmap, ROBOT, frame, asked), ROBOT)
        for bins in BINS:
            at_bins = model.traction_per_m(heightmap, ROBOT, frame, heading_bins(bins))
            error = np.abs(prices(at_bins @ interpolation_matrix(asked, bins).T, ROBOT) - true)
            known = np.isfinite(error)
            shares = [100 * f(error[known]) / true[known].mean() for f in (np.mean, lambda e: np.percentile(e, 99))]
            words = f"{name}, {bins} bins: off by {shares[0]:.3f} % of the mean price, 99 % within {shares[1]:.2f} %"
            rows.append(("60 x 60", words, np.nan, "the model at 90 random headings", None))
    return rows


def prices(traction_per_m: np.ndarray, robot: Robot) -> np.ndarray:
    """[J/m], any shape."""
    return np.asarray(robot.price_per_m(traction_per_m), dtype=np.float64)
