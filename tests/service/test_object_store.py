"""Everything is kept in an object store: services and workers that share no folder do what those with one folder do."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient

from joulemap.model.errors import DamagedError, InputError
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.http.app import create_app
from joulemap.service.storage import vault as vaults
from joulemap.service.storage.store import Store
from joulemap.service.storage.vault import ObjectVault, Part
from tests.service.clusters import cluster, free_port
from tests.service.conftest import GOAL, START, settings_for
from tests.service.preload import disturbed
from tests.service.test_calibrations import run_csv
from tests.service.test_data_directory import joulemap
from tests.service.test_restart import ask, status, wait_until
from tests.service.test_workers import undisturbed
from tests.service.workers import fingerprint, rolling

pytest.importorskip("obstore")
moto = pytest.importorskip("moto.server")

MAP = {"model": "physics", "headings": 8}


class Wire:
    """A port that passes everything on to another one, while it is not cut."""

    def __init__(self, port: int) -> None:
        self._port, self.cut, self.hang = port, False, 0
        self._hung: list[asyncio.StreamWriter] = []
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        server = asyncio.start_server(self._join, "127.0.0.1", 0)
        self._server = asyncio.run_coroutine_threadsafe(server, self._loop).result(10.0)
        self.url = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def _join(self, near: asyncio.StreamReader, to_near: asyncio.StreamWriter) -> None:
        """Pass on what comes and goes; one connection that fails leaves the way open for the next."""
        if self.hang > 0:  # this connection stays open, and nobody answers on it
            self.hang -= 1
            self._hung.append(to_near)
            return
        try:
            if self.cut:
                raise ConnectionError("the way is cut")
            far, to_far = await asyncio.open_connection("127.0.0.1", self._port)
        except OSError:
            to_near.close()
            return
        await asyncio.gather(self._pass(near, to_far), self._pass(far, to_near))

    async def _pass(self, one: asyncio.StreamReader, other: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while (data := await one.read(1 << 16)) and not self.cut:
                other.write(data)
                await other.drain()
        other.close()  # who reads from it sees its end, and ends too

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._server.close)


@pytest.fixture(scope="module")
def wire() -> Iterator[Wire]:
    """The way to an S3-compatible server with the bucket `maps`, which all of this process and its children use."""
    port = free_port()
    command = [sys.executable, "-c", "import sys; from moto.server import main; main()", "-H", "127.0.0.1"]
    with subprocess.Popen([*command, "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            wait_until(lambda: _made_bucket(port))
            way = Wire(port)
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("AWS_ENDPOINT_URL", way.url)
                patch.setenv("AWS_ACCESS_KEY_ID", "key")
                patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
                patch.setenv("AWS_REGION", "us-east-1")
                yield way
            way.close()
        finally:
            server.kill()


def _made_bucket(port: int) -> bool:
    try:
        return httpx.put(f"http://127.0.0.1:{port}/maps").is_success
    except httpx.TransportError:
        return False


@contextmanager
def service(folder: Path, database: Path, name: str, scheduler: str) -> Iterator[TestClient]:
    settings = settings_for(
        folder, database_url=f"sqlite:///{database}", store=f"s3://maps/{name}", scheduler=scheduler
    )
    with TestClient(create_app(settings)) as client:
        yield client


@pytest.mark.parametrize("url", ["s3://maps/vault", "file://{folder}/objects"])
def test_what_is_kept_is_there_as_a_whole_or_not_at_all(tmp_path: Path, wire: Wire, url: str) -> None:
    vault = ObjectVault(url.format(folder=tmp_path))
    made = tmp_path / "made.zarr"
    (made / "c").mkdir(parents=True)
    for name, content in (("zarr.json", b"{}"), ("c/0", b"x" * 1_000_000)):
        (made / name).write_bytes(content)
    vault.send("maps/made.zarr", made, ["zarr.json", "c/0"])
    with pytest.raises(FileNotFoundError):  # all is sent but the record
        vault.fetch("maps/made.zarr", tmp_path / "early")
    vault.put("maps/made.zarr", made)
    vault.put("maps/one.tif", made / "c/0")
    assert vault.size("maps/made.zarr", made) == 1_000_002
    vault.fetch("maps/made.zarr", tmp_path / "copy.zarr")
    vault.fetch("maps/one.tif", tmp_path / "one.tif")
    assert (tmp_path / "copy.zarr/c/0").read_bytes() == (tmp_path / "one.tif").read_bytes() == b"x" * 1_000_000
    vault.write("maps/made.zarr/c/0", b"y" * 1_000_000)
    with pytest.raises(DamagedError, match=r"has not what was kept.* check --repair"):
        vault.fetch("maps/made.zarr", tmp_path / "damaged")
    assert not (tmp_path / "damaged").exists()
    for key in ("maps/made.zarr", "maps/one.tif", "maps/never"):
        vault.remove(key)
    assert list(vault.names("maps")) == []
    with pytest.raises(FileNotFoundError):
        vault.fetch("maps/made.zarr", tmp_path / "late")
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.slow
def test_services_and_workers_that_share_no_folder(tmp_path: Path, wire: Wire, hill_tif: bytes) -> None:
    """A worker that is killed leaves its tiles to another machine; the cost map is that of one process, bit by bit."""
    expected = undisturbed(tmp_path / "alone")
    slow = disturbed(tile_cells=32, pause_s=0.5)
    tif = write_geotiff(None, rolling(95))
    assert tif is not None
    database = tmp_path / "shared.db"
    with (
        cluster(1, JOULEMAP_DATA_DIR=str(tmp_path / "machine-1"), **slow) as (address, begun),
        service(tmp_path / "a", database, "shared", address) as front,
        service(tmp_path / "b", database, "shared", address) as other,
    ):
        place = ask(front, tif)
        name = place.rsplit("/", 1)[-1]
        vault = ObjectVault("s3://maps/shared")
        wait_until(lambda: any(True for _ in vault.names(f"costmaps/{name}.zarr.tiles")))
        begun[1].send_signal(signal.SIGKILL)
        with cluster_worker(address, tmp_path / "machine-2"):
            wait_until(lambda: status(other, place) == "done")
            wait_until(lambda: not list(vault.names(f"costmaps/{name}.zarr.tiles")))
            question = {"start": [500_010.5, 4_000_100.5], "goal": [500_080.5, 4_000_150.5]}
            answers = [client.post(f"{place}/paths", json=question) for client in (front, other)]
            assert [answer.status_code for answer in answers] == [200, 200]
            assert answers[0].json()["path"] == answers[1].json()["path"]
            made = [tmp_path / folder / "costmaps" / f"{name}.zarr" for folder in ("a", "b", "machine-2")]
            assert [fingerprint(folder) for folder in made] == [expected] * 3
            assert other.get(f"{place}/data", params={"format": "zarr"}).content[:2] == b"PK"
            heightmap = front.get(place).json()["heightmap_id"]
            assert other.delete(place).status_code == 204
            assert other.delete(f"/v1/heightmaps/{heightmap}").status_code == 204
            assert list(vault.names("")) == []
            _calibrates(front, other, hill_tif)


def _calibrates(front: TestClient, other: TestClient, hill_tif: bytes) -> None:
    """The report and the model of a calibration are there for a service that made neither."""
    heightmap = front.post("/v1/heightmaps", content=hill_tif).json()["id"]
    runs = front.post("/v1/runs", content=run_csv(0), params={"heightmap_id": heightmap}).json()["id"]
    asked = {"heightmap_id": heightmap, "runs": [runs], "model": "physics", "quick": True}
    made = front.post("/v1/calibrations", json=asked)
    assert made.status_code == 202, made.text
    place = made.headers["location"]
    wait_until(lambda: status(other, place) not in ("queued", "running"), 300.0)
    assert status(other, place) == "done", other.get(place).json()
    assert "<html" in other.get(f"{place}/report.html").text
    model = other.get(place).json()["id"]
    raster = front.post("/v1/heightmaps", content=hill_tif, params={"layer": True}).json()[
        "id"
    ]  # another file to fetch
    asked = {"heightmap_id": heightmap, "model": model, "headings": 8, "layers": {"height": {"heightmap_id": raster}}}
    costmap = other.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"}).json()
    assert costmap["status"] == "done", costmap
    answer = front.post(f"/v1/costmaps/{costmap['id']}/paths", json={"start": START, "goal": GOAL})
    assert answer.status_code == 200, answer.text


@contextmanager
def cluster_worker(address: str, folder: Path) -> Iterator[None]:
    command = [sys.executable, "-m", "dask", "worker", address, "--host", "127.0.0.1", "--no-dashboard"]
    env = {**os.environ, **disturbed(tile_cells=32), "JOULEMAP_DATA_DIR": str(folder)}
    env["PYTHONPATH"] = str(Path(__file__).resolve().parents[2])
    with subprocess.Popen([*command, "--nthreads", "1", "--no-nanny"], env=env) as process:
        try:
            yield
        finally:
            process.kill()


@pytest.mark.parametrize("meanwhile", ["tidy", "delete"])
def test_a_copy_that_is_fetched_while_its_job_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, meanwhile: str
) -> None:
    store = Store(tmp_path / "data", f"sqlite:///{tmp_path / 'kept.db'}", objects=f"file://{tmp_path}/objects")
    store.open()
    place = store.lattice_path("cm-0123456789ab")
    (place / "c").mkdir(parents=True)
    (place / "c/0").write_bytes(b"prices")
    assert isinstance(store.vault, ObjectVault)
    store.vault.put(f"costmaps/{place.name}", place)
    shutil.rmtree(place)
    get = ObjectVault.get

    def _get(vault: ObjectVault, key: str, target: Path, parts: dict[str, Part]) -> None:
        get(vault, key, target, parts)
        if meanwhile == "tidy":  # by the service that made the job, whose row says already that it is done
            store.tidy("cm-0123456789ab")
        else:
            store.discard("cm-0123456789ab", tmp_path / "models")

    monkeypatch.setattr(ObjectVault, "get", _get)
    store.here(place)
    assert [path.relative_to(place).as_posix() for path in place.rglob("?")] == (["c", "c/0"] * (meanwhile == "tidy"))
    assert [path.name for path in place.parent.iterdir()] == [place.name] * (meanwhile == "tidy")
    store.close()


def test_an_object_store_that_is_away_is_told_and_waited_for(tmp_path: Path, wire: Wire, hill_tif: bytes) -> None:
    settings = settings_for(tmp_path, store="s3://maps/away", workers=1)  # its worker knows the way to the store
    with TestClient(create_app(settings)) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        wait_until(lambda: client.get("/readyz").status_code == 200)
        wire.cut = True
        refused = client.post("/v1/heightmaps", content=hill_tif)
        assert refused.status_code == 503, refused.text
        assert "object store does not answer" in refused.json()["detail"]
        assert int(refused.headers["Retry-After"]) > 0
        assert client.get("/v1/heightmaps").json()["total"] == 1
        assert [path.name for path in (tmp_path / "heightmaps").iterdir()] == [f"{heightmap}.tif"]
        wait_until(lambda: "object store" in client.get("/readyz").text)
        place = client.post("/v1/costmaps", json={"heightmap_id": heightmap, **MAP}).headers["location"]
        time.sleep(1.0)
        assert status(client, place) in ("queued", "running")
        wire.cut = False
        wait_until(lambda: status(client, place) == "done")
        wait_until(lambda: client.get("/readyz").status_code == 200)


def test_a_connection_that_hangs_is_given_up_and_another_one_asked(
    tmp_path: Path, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vaults, "_RECORD_S", 1.0)
    monkeypatch.setattr(vaults, "_CONTENT_S", 1.0)
    sent, copy, keep = tmp_path / "sent", tmp_path / "copy", "maps/hangs"
    sent.write_bytes(os.urandom(vaults.PIECE_BYTES + 1_000))  # in two pieces
    wire.hang, began = 2, time.monotonic()  # of records, and of pieces
    vault = ObjectVault("s3://maps/hang")
    vault.put(keep, sent)
    vault.fetch(keep, copy)
    assert copy.read_bytes() == sent.read_bytes()
    assert wire.hang == 0
    wire.hang = 1_000
    with pytest.raises(OSError, match="does not answer"):
        ObjectVault("s3://maps/hang").read("records/none.json")
    assert time.monotonic() - began < 20.0
    wire.hang = 0


def test_a_damaged_object_is_told_and_a_check_makes_the_map_again(
    tmp_path: Path, hill_tif: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    objects = tmp_path / "objects"
    settings = settings_for(tmp_path / "data", store=f"file://{objects}")
    question = {"start": START, "goal": GOAL}
    with TestClient(create_app(settings)) as client:
        place = client.post("/v1/costmaps", files={"file": hill_tif}, data={"options": json.dumps(MAP)}).headers[
            "location"
        ]
        wait_until(lambda: status(client, place) == "done")
        asked = client.post(f"{place}/paths", json=question).json()
    name = place.rsplit("/", 1)[-1]
    chunk = max((path for path in (objects / f"costmaps/{name}.zarr").rglob("*") if path.is_file()), key=_size)
    chunk.write_bytes(bytes(_size(chunk)))
    shutil.rmtree(tmp_path / f"data/costmaps/{name}.zarr")  # the copy of another service's machine
    with TestClient(create_app(settings)) as client:
        refused = client.post(f"{place}/paths", json=question)
        assert (refused.status_code, refused.json()["code"]) == (503, "damaged"), refused.text
        assert "check --repair" in refused.json()["detail"]
    monkeypatch.setenv("JOULEMAP_STORE", f"file://{objects}")
    code, repaired = joulemap("check", "--repair", "--data-dir", tmp_path / "data")
    assert (code, [one["kind"] for one in repaired["findings"]]) == (0, ["missing"])
    with TestClient(create_app(settings)) as client:
        wait_until(lambda: status(client, place) == "done")
        assert client.post(f"{place}/paths", json=question).json()["path"] == asked["path"]


def _size(path: Path) -> int:
    return path.stat().st_size


@pytest.mark.parametrize("url", ["nowhere://maps", "s3://", "s3:///x"])
def test_a_url_of_no_object_store_is_refused_in_words(url: str) -> None:
    with pytest.raises(InputError, match="no object store that can be used"):
        ObjectVault(url)
