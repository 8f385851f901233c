"""Two workers beside one: seconds for a cost map that plain Dask workers make tile by tile, a thread each.

Two clusters of one worker each, which share nothing but the machine, say how much two workers could be.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from distributed import Client

from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cluster.connection import connected
from joulemap.service.jobs.costmaps import make
from joulemap.service.work.tiles import MapOrder
from tests.bench.maps import ROBOT, terrain
from tests.bench.timing import Row
from tests.service.clusters import compose_environment, free_port

CELLS = 2304
WORKERS = (1, 2)
ROUNDS = 3
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def bench_workers(cells: int = CELLS) -> list[Row]:
    """The least seconds of several rounds in turns, from the moment all workers stand ready."""
    times: dict[int, list[float]] = {count: [] for count in WORKERS}
    separate: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_geotiff(place / "dem.tif", terrain(cells, 1.0))
        write_geotiff(place / "small.tif", terrain(cells // 16, 1.0))
        for number in range(ROUNDS):
            for count in WORKERS:
                times[count].append(seconds_of(place, count, f"{count}-{number}"))
            with ThreadPoolExecutor(2) as both:
                separate.append(max(both.map(seconds_of, (place, place), (1, 1), (f"a-{number}", f"b-{number}"))))
    alone = min(times[WORKERS[0]])
    rows: list[Row] = []
    for count, took in times.items():
        load = f"load of the machine {os.getloadavg()[0]:.1f}"
        words = f"{count} Dask worker(s), {alone / min(took):.2f} times one ({load})"
        rows.append((f"{cells} x {cells}", words, min(took), "one worker", min(took) / alone))
    words = f"two clusters of one worker, a map each: {2.0 * alone / min(separate):.2f} times one"
    rows.append((f"{cells} x {cells}", words, min(separate), "one worker", min(separate) / alone))
    return rows


def seconds_of(folder: Path, count: int, name: str) -> float:
    """Seconds for a cost map by so many workers, which have made a small one before."""
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    dask = [sys.executable, "-m", "dask"]
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    with ExitStack() as stack:
        for command in (scheduler, *[worker] * count):
            settings = os.environ | compose_environment(command[0]) | ONE_THREAD
            process = subprocess.Popen([*dask, *command], env=settings, stderr=subprocess.DEVNULL)
            stack.enter_context(process)
            stack.callback(process.kill)
        return asyncio.run(_seconds(folder, address, count, name))


async def _seconds(folder: Path, address: str, count: int, name: str) -> float:
    async with connected(address, workers=0) as client:
        await client.wait_for_workers(count)
        await client.run(_warm)
        await _make(client, folder / "small.tif", f"{name}-small")  # the scheduler loads what orders are made of
        began = time.perf_counter()
        await _make(client, folder / "dem.tif", name)
        return time.perf_counter() - began


async def _make(client: Client, heightmap: Path, name: str) -> None:
    order = MapOrder(heightmap.with_name(f"{name}.zarr"), heightmap, {}, ROBOT.as_dict(), "default", 1.0, 16)
    order.notes.mkdir(parents=True)
    await make(client, order, key=name, report=_unheard)


async def _unheard(_share: float) -> None:
    """Nobody looks at the progress."""


def _warm() -> None:
    from joulemap.service.warm_up import warm_up_models

    warm_up_models(["default"])


if __name__ == "__main__":
    for row in bench_workers(*map(int, sys.argv[1:2])):
        print(row)
