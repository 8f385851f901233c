"""The demo, end to end: a real service in a process of its own, asked over HTTP, and nothing left over."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.synthesis import SAMPLE_GOAL, SAMPLE_START
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.commands.demo import free_corners
from tests.reference.lattices import price_world_path

JOULEMAP = str(Path(sys.executable).with_name("joulemap"))


def test_the_demo_answers_and_ends(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [JOULEMAP, "demo", "--exit", "--out", str(out), "--json", str(tmp_path / "demo.json")]
    where = {"JOULEMAP_HOST": "localhost", "JOULEMAP_PORT": str(port)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, env=os.environ | where)
    assert done.returncode == 0, done.stderr
    said = json.loads((tmp_path / "demo.json").read_text())
    assert said["url"] == f"http://localhost:{port}"
    path, shortest = said["path"], said["path"]["shortest"]
    assert (said["start"], said["goal"]) == (list(SAMPLE_START), list(SAMPLE_GOAL))
    assert path["energy_j"] < 0.95 * shortest["energy_j"]  # the sample is made so that going round the knoll pays
    assert path["length_m"] > shortest["length_m"]
    lattice = load_lattice(out / "costmap.zarr")
    assert price_world_path(lattice, path["path"]) == pytest.approx(path["energy_j"], rel=1e-6)
    assert lattice.provenance["model"]["name"] == "default"
    verdict = said["feasibility"]
    assert verdict["feasible"]
    assert verdict["energy_j"] > path["energy_j"]  # there and back
    for words in (f"{path['length_m']:.1f} m", "less than the shortest", "charge at the end", "Picture"):
        assert words in done.stdout
    assert (out / "joulemap-demo.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{said['url']}/healthz", timeout=2.0)


@pytest.mark.slow
def test_the_service_goes_on_until_it_is_stopped(tmp_path: Path) -> None:
    """On another heightmap, with the wanted port taken; Ctrl-C ends both processes."""
    row, col = np.mgrid[0:24, 0:30]
    np.save(tmp_path / "dem.npy", (0.02 * row + 0.3 * np.sin(0.4 * col)).astype(np.float32))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        command = [JOULEMAP, "demo", "--model", "physics", "--port", str(port), "--out", str(tmp_path / "demo")]
        process = subprocess.Popen(
            [*command, "--heightmap", str(tmp_path / "dem.npy"), "--resolution", "1"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1", "JOULEMAP_WARM_MODELS": '["physics"]'},
        )
        assert process.stdout is not None
        said = ""
        while "Ctrl-C" not in said:
            line = process.stdout.readline()
            assert line, process.communicate()[1]
            said += line
    url = next(word for word in said.split() if word.startswith("http://"))
    assert url != f"http://127.0.0.1:{port}"
    assert httpx.get(f"{url}/v1/costmaps", timeout=10.0).json()["total"] == 1
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        try:
            httpx.get(f"{url}/healthz", timeout=1.0)
        except httpx.TransportError:
            return
    pytest.fail("the service outlived the demo")


def test_an_unreadable_heightmap_starts_no_service(tmp_path: Path) -> None:
    (tmp_path / "dem.tif").write_bytes(b"II*\0 and then nothing")
    command = [JOULEMAP, "demo", "--exit", "--out", str(tmp_path / "demo"), "--heightmap", str(tmp_path / "dem.tif")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 3
    assert done.stderr.startswith("error: ")
    assert not (tmp_path / "demo").exists()


def test_free_corners_are_joined_by_a_route() -> None:
    """A wall with the corner behind it cut off: both ends lie in the larger piece."""
    heights = np.zeros((20, 30), dtype=np.float32)
    heights[:, 22:24] = 5.0
    heights[0:6, 0:6] = np.nan
    heightmap = Heightmap(heights, GridFrame(100.0, 20.0, 1.0, 20, 30))
    lattice = build_lattice(heightmap, Robot(), PhysicsPredictor())
    start, goal = free_corners(lattice)
    assert start[0] < 103.0
    assert start[1] < 3.0
    assert 115.0 < goal[0] < 122.0
    assert goal[1] > 17.0
    assert RoutePlanner(lattice).plan(start, goal).route.energy_j > 0.0
