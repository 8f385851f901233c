"""Jobs done by plain Dask workers at a scheduler's address, for two services that share a database."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

import pytest
from distributed import Client
from fastapi.testclient import TestClient
from sqlalchemy import create_engine

from joulemap.model.errors import JoulemapError
from joulemap.model.robot import Robot
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import tiles as tiling
from joulemap.planner.lattice.build import provenance_of
from joulemap.service.cluster.connection import connected
from joulemap.service.http.app import create_app
from joulemap.service.jobs.costmaps import make
from joulemap.service.library.heightmaps import read_heightmap
from joulemap.service.storage.data_folder import Claims
from joulemap.service.storage.store import Store
from joulemap.service.work import tiles
from joulemap.service.work.tiles import MapOrder
from tests.service.clusters import ROOT, cluster, free_port, shared_scheduler
from tests.service.conftest import settings_for
from tests.service.preload import disturbed
from tests.service.test_restart import ask, serving, status, wait_until
from tests.service.workers import asked, fingerprint, made_here, postgres_programs, postgres_server, rolling

needs_postgres = pytest.mark.skipif(postgres_programs() is None, reason="PostgreSQL is not installed")


def of_rolling(client: Any) -> str:
    """Ask for a cost map of the rolling ground; its place."""
    tif = write_geotiff(None, rolling(95))
    assert tif is not None
    return ask(client, tif)


def undisturbed(folder: Path) -> str:
    """The fingerprint of the lattice that the service is asked for, made in this process."""
    store = Store(folder, f"sqlite:///{folder / 'alone.db'}")
    store.open()
    heightmap = store.add_heightmap(rolling(95), name="rolling", stats={}).id
    costmap_id = asked(store, heightmap)
    made_here(store, costmap_id, folder)
    made = fingerprint(store.lattice_path(costmap_id))
    store.close()
    return made


def test_plain_dask_workers_do_the_jobs_of_a_service(tmp_path: Path) -> None:
    expected = undisturbed(tmp_path / "alone")
    with cluster(1) as (address, _), TestClient(create_app(settings_for(tmp_path, scheduler=address))) as client:
        place = of_rolling(client)
        wait_until(lambda: status(client, place) == "done")
        assert fingerprint(tmp_path / "costmaps" / f"{place.rsplit('/', 1)[-1]}.zarr") == expected


def test_workers_do_not_wait_for_the_one_that_reads_the_whole_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiling, "TILE_CELLS", 48)
    described: list[Any] = []

    def _described(*arguments: Any) -> dict[str, Any]:
        described.append(provenance_of(*arguments))
        return described[-1]

    monkeypatch.setattr(tiles, "provenance_of", _described)
    write_geotiff(ground := tmp_path / "ground.tif", rolling(95))
    order = MapOrder(tmp_path / "map.zarr", ground, {}, Robot().as_dict(), "physics", 1.0, 8)
    order.notes.mkdir()
    count, missing = tiles.lay_out(order)
    for number in missing[1:]:
        tiles.build(order, number)
    assert count > 1
    assert described == []
    tiles.build(order, 0)
    assert tiles.finish(order)["provenance"] == described[0]
    assert len(described) == 1


def test_a_map_whose_making_is_not_noted_is_finished(tmp_path: Path) -> None:
    """As where an earlier version, or a machine with another folder of copies, built the first tile."""
    write_geotiff(ground := tmp_path / "ground.tif", rolling(95))
    order = MapOrder(tmp_path / "map.zarr", ground, {}, Robot().as_dict(), "physics", 1.0, 8)
    order.notes.mkdir()
    for number in tiles.lay_out(order)[1]:
        tiles.build(order, number)
    (order.notes / "provenance.json").unlink()
    assert tiles.finish(order)["provenance"]["heightmap"]["hash"] == read_heightmap(ground).data_hash


@pytest.mark.slow
def test_a_scheduler_that_comes_late_is_waited_for(tmp_path: Path) -> None:
    port = free_port()
    settings = settings_for(tmp_path, scheduler=f"tcp://127.0.0.1:{port}")
    with TestClient(create_app(settings)) as client:
        place = of_rolling(client)
        wait_until(lambda: "no Dask scheduler answers" in (client.app.state.service.jobs.trouble or ""))  # type: ignore[attr-defined]
        assert status(client, place) == "queued"
        with cluster(1, port=port):
            wait_until(lambda: status(client, place) == "done")
            assert client.app.state.service.jobs.trouble is None  # type: ignore[attr-defined]


def test_what_failed_is_made_again_though_somebody_still_holds_the_error(tmp_path: Path) -> None:
    """Dask would answer with the error of the first try as long as its future is known by name."""
    ground = tmp_path / "ground.tif"
    order = MapOrder(tmp_path / "map.zarr", ground, {}, Robot().as_dict(), "physics", 1.0, 8)
    order.folder.begin()
    shares: list[float] = []

    async def _report(share: float) -> None:
        shares.append(share)

    async def _make(client: Client) -> Any:
        return await make(client, order, key="cm-again", report=_report)

    async def _twice() -> dict[str, Any]:
        async with connected(shared_scheduler(), workers=0) as client:
            with pytest.raises(JoulemapError) as held:
                await _make(client)
            write_geotiff(ground, rolling(20))
            await asyncio.sleep(0.1)  # what is let go is let go by the loop
            made = await _make(client)
            del held
            return made

    assert asyncio.run(_twice())["frame"]["rows"] == 20
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] < 1.0


@pytest.mark.slow
@needs_postgres
def test_two_services_and_two_workers_of_which_half_is_killed(tmp_path: Path) -> None:
    """The service that sent the job off, the scheduler and a worker are killed one after another."""
    expected = undisturbed(tmp_path / "alone")
    slow = disturbed(pause_s=1.0)
    port = free_port()
    with postgres_server(free_port()) as server, ExitStack() as stack:
        address, workers = stack.enter_context(cluster(2, port=port, **slow))
        shared = {"JOULEMAP_SCHEDULER": address, "JOULEMAP_DATABASE_URL": server.url}
        _, survivor = stack.enter_context(serving(tmp_path, **shared))
        with serving(tmp_path, **shared) as (_, http):
            place = of_rolling(http)
            wait_until(lambda: status(survivor, place) == "running")
        workers[1].send_signal(signal.SIGKILL)  # after the service
        workers[2].send_signal(signal.SIGKILL)
        workers[0].send_signal(signal.SIGKILL)
        for worker in workers:
            worker.wait()
        stack.enter_context(cluster(1, port=port))
        wait_until(lambda: status(survivor, place) == "done")
        assert fingerprint(tmp_path / "costmaps" / f"{place.rsplit('/', 1)[-1]}.zarr") == expected


@needs_postgres
@pytest.mark.slow
def test_a_lost_database_is_told_and_jobs_go_on_when_it_is_back(tmp_path: Path) -> None:
    with ExitStack() as stack:
        server = stack.enter_context(postgres_server(free_port()))
        slow = disturbed(tile_cells=64, pause_s=0.5)
        _, http = stack.enter_context(serving(tmp_path, JOULEMAP_DATABASE_URL=server.url, **slow))
        place = of_rolling(http)
        wait_until(lambda: status(http, place) == "running")
        server.stop()
        refused = http.get(place)
        assert (refused.status_code, refused.json()["code"]) == (503, "busy"), refused.text
        assert "retry-after" in refused.headers
        time.sleep(5.0)  # several looks of the service
        server.start()
        wait_until(lambda: status(http, place) == "done")


@pytest.mark.parametrize("database", ["sqlite", pytest.param("postgresql", marks=[needs_postgres, pytest.mark.slow])])
def test_a_job_is_claimed_once_and_given_back_by_a_process_that_ends(tmp_path: Path, database: str) -> None:
    with postgres_server(free_port()) if database == "postgresql" else nullcontext() as server:
        url = server.url if server else f"sqlite:///{tmp_path / 'a.db'}"
        code = (
            "import sys; from pathlib import Path; from sqlalchemy import create_engine\n"
            "from joulemap.service.storage.data_folder import Claims\n"
            "claims = Claims(create_engine(sys.argv[1]), Path(sys.argv[2]))\n"
            "print(sorted(claims.keep(['cm-01', 'cm-02'])), flush=True)\n"
            "sys.stdin.read()"
        )
        claims = Claims(create_engine(url), tmp_path / "claims")
        command = [sys.executable, "-c", code, url, str(tmp_path / "claims")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": {**os.environ, "PYTHONPATH": str(ROOT)}}
        with subprocess.Popen(command, text=True, **pipes) as other:  # type: ignore[call-overload]
            assert other.stdout.readline() == "['cm-01', 'cm-02']\n"
            assert claims.keep(["cm-02", "cm-03"]) == {"cm-03"}
            other.send_signal(signal.SIGKILL)
        wait_until(lambda: claims.keep(["cm-02", "cm-03"]) == {"cm-02", "cm-03"})
        other_of_process = Claims(create_engine(url), tmp_path / "claims")
        assert other_of_process.keep(["cm-02", "cm-04"]) == {"cm-04"}  # of this process, too
        other_of_process.close()
        assert claims.keep([]) == set()
        claims.close()
