"""A disk that is really full, a small file system in memory: 507, nothing half written, and work goes on with room."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import read_heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.service.clusters import ROOT, free_port
from tests.service.test_calibrations import run_csv
from tests.service.test_restart import SERVE, answers, status, wait_until

_ALONE = ["unshare", "--map-root-user", "--mount"]
"""A command that may mount file systems that nobody else sees."""
_MOUNT = 'mount -t tmpfs -o size="$1" tmpfs "$2" && shift 2 && exec "$@"'

needs_mounts = pytest.mark.skipif(
    shutil.which("unshare") is None or subprocess.run([*_ALONE, "true"], capture_output=True).returncode != 0,
    reason="no file system can be mounted here",
)


def on_small_disk(size: str, folder: Path, *command: str) -> list[str]:
    """A command that sees a small file system at `folder`."""
    return [*_ALONE, "sh", "-c", _MOUNT, "sh", size, str(folder), *command]


def rough(cells: int) -> Heightmap:
    """Heights that do not compress."""
    heights = np.random.default_rng(0).normal(size=(cells, cells)).astype(np.float32)
    return Heightmap(heights, GridFrame(500_000.0, 4_000_000.0 + cells, 1.0, cells, cells, "EPSG:32630"))


WRITE = """
import os, sys
from pathlib import Path
from joulemap.model.terrain.writers import write_geotiff
from tests.service.test_full_disk import rough
folder, heightmap = Path(sys.argv[1]), rough(700)
size = len(write_geotiff(None, heightmap, quick=True))
for room in [size + 2_000_000, *range(size + 8192, size - 40_000, -4096), size // 2, 4096]:
    (folder / "other").write_bytes(bytes(os.statvfs(folder).f_bavail * 4096 - room))
    try:
        write_geotiff(folder / "map.tif", heightmap, quick=True)
        print(room > size and (folder / "map.tif").stat().st_size == size)
    except OSError as error:
        print(error.errno == 28 and not list(folder.glob("*map.tif*")))
    for path in folder.iterdir():
        path.unlink()
"""


@needs_mounts
def test_a_heightmap_is_written_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    """GDAL does not tell of every write that fails."""
    command = on_small_disk("8m", tmp_path, sys.executable, "-c", WRITE, str(tmp_path))
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(ROOT)}, cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == {"True"}
    assert len(done.stdout.split()) > 10


@contextmanager
def serving_on_small_disk(folder: Path) -> Iterator[tuple[httpx.Client, Path]]:
    """A service, and its data folder as this process sees it."""
    port = free_port()
    command = on_small_disk("24m", folder, sys.executable, "-c", SERVE, str(folder), str(port))
    env = {**os.environ, "PYTHONPATH": str(ROOT), "JOULEMAP_MIN_FREE_MB": "2", "JOULEMAP_WORKERS": "1"}
    process = subprocess.Popen(command, env=env, cwd=ROOT)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0) as http:
            wait_until(lambda: answers(http, "/readyz"))
            yield http, Path(f"/proc/{process.pid}/root") / folder.relative_to("/")
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


@needs_mounts
def test_a_full_disk_is_told_over_http_and_work_goes_on_with_room(tmp_path: Path) -> None:
    small, large = (write_geotiff(None, rough(cells)) for cells in (300, 1200))
    runs = run_csv(0, metres=30.0)
    with serving_on_small_disk(tmp_path) as (http, folder):
        kept = http.post("/v1/heightmaps", content=small)
        assert kept.status_code == 201, kept.text
        place = f"/v1/heightmaps/{kept.json()['id']}"
        other = folder / "other"
        other.write_bytes(bytes(os.statvfs(folder).f_bavail * 4096 - 9_000_000))
        _refused(http.post("/v1/heightmaps", content=large))  # there is room for it, but not for a second one
        _refused(http.post("/v1/heightmaps", content=large))
        with other.open("ab") as more:
            more.write(bytes(os.statvfs(folder).f_bavail * 4096 - 200_000))
        _refused(http.post("/v1/heightmaps", content=small))
        _refused(http.post("/v1/runs", content=runs * 20))
        wait_until(lambda: "the disk is full" in http.get("/readyz").text)
        assert http.get("/healthz").status_code == 200
        assert http.get(place).json() == kept.json()
        assert [path.name for path in (folder / "heightmaps").iterdir()] == [f"{kept.json()['id']}.tif"]
        assert list((folder / "runs").iterdir()) == []
        assert [path for path in (folder / "uploads").rglob("*") if path.is_file() and path.suffix != ".lock"] == []
        asked = {"heightmap_id": kept.json()["id"], "model": "physics", "headings": 8}
        job = http.post("/v1/costmaps", json=asked)
        if job.status_code == 202:  # the database may have found room for its row
            wait_until(lambda: status(http, job.headers["location"]) in ("queued", "running"))
        else:
            _refused(job)
        other.unlink()
        job = http.post("/v1/costmaps", json=asked) if job.status_code != 202 else job
        wait_until(lambda: status(http, job.headers["location"]) == "done")
        wait_until(lambda: answers(http, "/readyz"))
        again = read_heightmap((folder / "heightmaps" / f"{kept.json()['id']}.tif").read_bytes())
        np.testing.assert_array_equal(again.heights, rough(300).heights)


def _refused(answer: httpx.Response) -> None:
    assert answer.status_code == 507, answer.text
    assert json.loads(answer.text)["code"] == "storage_full"
