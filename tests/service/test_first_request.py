"""Nobody waits for a compiler: after warming up, a request on a real map compiles nothing more."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROBE = """
import gc, json, sys, tempfile
from contextlib import suppress
from pathlib import Path
from fastapi.testclient import TestClient
from numba.core.dispatcher import Dispatcher
from joulemap.model.errors import BusyError
from joulemap.service.http.app import create_app
from tests.service.conftest import GOAL, START, hill, settings_for
from joulemap.model.terrain.writers import write_geotiff

def compiled():
    gc.unfreeze()  # a service that is ready has taken what it has loaded out of the garbage collector's sight
    own = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    own = [d for d in own if d.py_func.__module__.startswith(("joulemap.model", "joulemap.planner"))]
    return {f"{d.py_func.__module__}.{d.py_func.__name__}": sorted(map(str, d.signatures)) for d in own}

folder = tempfile.mkdtemp()
settings = settings_for(Path(folder), workers=1).model_copy(update={"warm_models": ("physics", "default")})
with TestClient(create_app(settings)) as client:
    service = client.app.state.service
    while True:
        with suppress(BusyError):  # without a cache, and on a busy machine, compiling takes its time
            service.kernels.wait()
            break
    before = compiled()
    heightmap = client.post("/v1/heightmaps", content=write_geotiff(None, hill())).json()["id"]
    for robot in ({}, {"regeneration": 0.5, "turn_j_per_rad": 2.0}):
        asked = {"heightmap_id": heightmap, "model": "physics", "robot": robot, "headings": 12}
        made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"}).json()["id"]
        for change in ({}, {"neighbours": 8}, {"neighbours": 32}, {"planner": "dijkstra"}, {"refine": False}):
            asked = {"start": START, "goal": GOAL, **change}
            assert client.post(f"/v1/costmaps/{made}/paths", json=asked).status_code == 200
        task = {"start": START, "goal": GOAL, "round_trip": True}
        assert client.post(f"/v1/costmaps/{made}/feasibility", json=task).status_code == 200
        assert client.get(f"/v1/costmaps/{made}/at", params={"x": START[0], "y": START[1]}).status_code == 200
    asked = {"heightmap_id": heightmap, "model": "physics", "robot": {"min_turning_radius_m": 1.0}, "headings": 12}
    made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"}).json()["id"]
    for change in ({}, {"goal_heading_deg": 90.0}):
        asked = {"start": START, "goal": GOAL, **change}
        assert client.post(f"/v1/costmaps/{made}/paths", json=asked).status_code == 200
    for spacing in (1.0, 0.5, 1.5):  # a network's tiles side by side or with gaps, and single squares
        asked = {"heightmap_id": heightmap, "model": "default", "spacing_m": spacing, "headings": 8}
        done = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"})
        assert done.json()["status"] == "done", done.json()
    after = compiled()
    assert len(before) > 10
    print(json.dumps({name: signatures for name, signatures in after.items() if before.get(name) != signatures}))
"""


@pytest.mark.slow
def test_requests_after_the_warm_up_compile_nothing() -> None:
    """In a process of its own, where nothing but the warm-up came before."""
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", PROBE],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().splitlines()[-1] == "{}", f"compiled after the warm-up: {done.stdout}"
