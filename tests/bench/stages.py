"""Every stage from heightmap to route, seconds each, and the main job over HTTP."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import numpy as np
import torch

from joulemap.model.energy.architectures.resnet18 import ResNetEnergy
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.route_planner import RoutePlanner
from tests.bench.maps import CORNERS, ROBOT, free_corner, physics_lattice, terrain
from tests.bench.searches import search_rows
from tests.bench.timing import Row, seconds
from tests.load import Server

RESNET_PATCHES = 16


def bench(cells: int, resolution_m: float) -> list[Row]:
    """One row per stage."""
    size = f"{cells} x {cells}"
    rows: list[Row] = []
    heightmap = terrain(cells, resolution_m)

    lattice = physics_lattice(heightmap)
    took = seconds(lambda: physics_lattice(heightmap))
    rows.append((size, "lattice, physics, 16 headings", took, "", None))
    default = load_predictor("default")
    network = seconds(lambda: build_lattice(heightmap, ROBOT, default), repeats=1)
    per_patch = resnet_seconds_per_patch(heightmap)
    rows.append(
        (
            size,
            "lattice, default network, 16 headings",
            network,
            "ResNet18, a 256 x 256 patch per value",
            network / (per_patch * cells * cells * 16),
        )
    )
    n = 10_000
    rng = np.random.default_rng(0)
    x, y = rng.uniform(2, cells - 2, (2, n))
    heading = rng.uniform(0, 2 * np.pi, n)
    for side in (32, 256):
        count = n if side == 32 else 500
        cut = seconds(lambda: cut_patches(heightmap, x[:count], y[:count], heading[:count], size=side))  # noqa: B023
        rows.append((size, f"{count} patches of {side} x {side}", cut, "", None))
    rows.append((size, f"ResNet18 on {RESNET_PATCHES} patches of 256 x 256", per_patch * RESNET_PATCHES, "", None))

    start, goal = (free_corner(lattice, end) for end in CORNERS)
    for neighbours in (8, 16, 32):
        rows += [(size, *row) for row in search_rows(lattice, neighbours, start, goal)]
    path = grid_search(lattice, move_table(lattice), start, goal).points
    rows.append((size, "any-angle improvement", seconds(lambda: improved(lattice, path)), "", None))
    planner = RoutePlanner(lattice)
    ends = [tuple(float(v) for v in lattice.frame.xy(*p)) for p in (start, goal)]
    rows.append((size, "a whole plan, moves priced before", seconds(lambda: planner.plan(*ends)), "", None))
    for stage, took in request_seconds(heightmap, list(ends[0]), list(ends[1]), "default").items():
        rows.append((size, f"over HTTP: {stage}", took, "", None))
    return rows


def request_seconds(heightmap: Heightmap, start: list[float], goal: list[float], model: str) -> dict[str, float]:
    """Seconds of the three requests of the main job, to a service in a process of its own."""
    body = write_geotiff(None, heightmap)
    out: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as ends:
        server = Server(Path(folder), {})
        ends.callback(server.stop)
        client = ends.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{server.port}", timeout=300.0))
        while not _is_ready(client):
            assert server.process.poll() is None, "the service has ended"
            time.sleep(0.1)
        began = time.perf_counter()
        uploaded = client.post("/v1/heightmaps", content=body, headers={"Content-Type": "image/tiff"}).json()
        out["upload"] = time.perf_counter() - began
        began = time.perf_counter()
        made = client.post(
            "/v1/costmaps", json={"heightmap_id": uploaded["id"], "model": model}, headers={"Prefer": "wait=300"}
        ).json()
        assert made["status"] == "done", made
        out["cost map"] = time.perf_counter() - began
        url = f"/v1/costmaps/{made['id']}/paths"
        for name in ("first path", "second path"):
            began = time.perf_counter()
            answer = client.post(url, json={"start": start, "goal": goal})
            assert answer.status_code == 200, answer.text
            out[name] = time.perf_counter() - began
    return out


def _is_ready(client: httpx.Client) -> bool:
    try:
        return client.get("/readyz").status_code == 200
    except httpx.ConnectError:
        return False


def resnet_seconds_per_patch(heightmap: Heightmap) -> float:
    """Seconds the paper's network takes for one 256 x 256 patch, in batches, on this machine."""
    torch.manual_seed(0)
    network = ResNetEnergy().eval()
    middle = heightmap.frame.resolution_m * heightmap.frame.cols / 2
    patches = torch.from_numpy(
        cut_patches(heightmap, *np.full((2, RESNET_PATCHES), middle), np.linspace(0, 6, RESNET_PATCHES), size=256)
    )
    with torch.inference_mode():
        return seconds(lambda: network(patches), repeats=2) / RESNET_PATCHES
