"""A disk that is really full, a small file system in memory: 507, nothing half written, and work goes on with room."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import httpx
import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.library.heightmaps import read_heightmap
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
folder, heightmap = Path(sys.argv[1]), rough(400)
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


@pytest.fixture(scope="module")
def small_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[httpx.Client, Path]]:
    """A service, and its data folder as this process sees it."""
    folder = tmp_path_factory.mktemp("small")
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
def test_a_full_disk_is_told_over_http_and_work_goes_on_with_room(small_disk: tuple[httpx.Client, Path]) -> None:
    small, large = (write_geotiff(None, rough(cells)) for cells in (300, 1200))
    runs = run_csv(0, metres=30.0)
    http, folder = small_disk
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
    assert [
        path for path in (folder / "uploads").rglob("*") if path.is_file() and not path.suffix.endswith("lock")
    ] == []
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


@needs_mounts
def test_room_is_there_before_work_is_accepted_and_deleting_needs_none(small_disk: tuple[httpx.Client, Path]) -> None:
    small = write_geotiff(None, rough(300))
    http, folder = small_disk
    places = [http.post("/v1/heightmaps", content=small).headers["location"] for _ in range(2)]
    heightmaps, costmaps = (http.get(f"/v1/{kind}").json()["total"] for kind in ("heightmaps", "costmaps"))
    asked = {"heightmap_id": places[0].rsplit("/", 1)[-1], "model": "physics", "headings": 8}
    other = folder / "other"
    other.write_bytes(bytes(_free(folder) - 7_000_000))
    _refused(http.post("/v1/costmaps", json=asked))  # 300 x 300 x 8 prices of 8 bytes
    assert http.get("/v1/costmaps").json()["total"] == costmaps
    first = _begins(http, "/v1/heightmaps", 4_000_000, "Content-Type: application/octet-stream", bytes(1_000_000))
    wait_until(lambda: _free(folder) < 6_500_000)
    wait_until(lambda: _answer_to(http, 3_000_000) == 507)  # beside what is on its way: it is not sent at all
    first.close()
    wait_until(lambda: _answer_to(http, 3_000_000) is None)
    form = _goes_on(
        http, "/v1/runs", 3_000_000, "Content-Type: multipart/form-data; boundary=x", FORM + bytes(2_000_000)
    )
    wait_until(lambda: _free(folder) < 5_500_000)  # what a form brings lies in the data folder too
    form.close()
    wait_until(lambda: _free(folder) > 6_500_000)
    with other.open("ab") as more:
        while room := _free(folder):
            more.write(bytes(min(room, 1 << 20)))
    assert http.delete(places[0]).status_code == 204
    assert http.get("/v1/heightmaps").json()["total"] == heightmaps - 1
    other.unlink()
    wait_until(lambda: (folder / "reserve").exists())  # for the next time
    assert http.post("/v1/costmaps", json={**asked, "heightmap_id": places[1].rsplit("/", 1)[-1]}).status_code == 202


FORM = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n'


def _free(folder: Path) -> int:
    return os.statvfs(folder).f_bavail * 4096


def _begins(http: httpx.Client, path: str, length: int, kind: str, body: bytes = b"") -> socket.socket:
    """A connection on which an upload has begun and does not go on."""
    connection = socket.create_connection(("127.0.0.1", http.base_url.port))
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{kind}\r\nContent-Length: {length}\r\n\r\n"
    connection.sendall(head.encode() + body)
    return connection


def _goes_on(http: httpx.Client, path: str, length: int, kind: str, body: bytes) -> socket.socket:
    """The same, begun anew while it is refused: the room of an upload that was given up is free a moment later."""
    for _ in range(50):
        connection = _begins(http, path, length, kind, body)
        connection.settimeout(1.0)
        try:
            connection.recv(100)
        except TimeoutError:
            return connection
        connection.close()
    raise AssertionError("it was refused again and again")


def _answer_to(http: httpx.Client, length: int) -> int | None:
    """The status that an upload gets of which nothing but the header is sent; None where more of it is awaited."""
    with closing(_begins(http, "/v1/heightmaps", length, "Content-Type: application/octet-stream")) as connection:
        connection.settimeout(2.0)
        with suppress(TimeoutError):
            return int(connection.recv(100).split()[1])
    return None


def _refused(answer: httpx.Response) -> None:
    assert answer.status_code == 507, answer.text
    assert json.loads(answer.text)["code"] == "storage_full"
