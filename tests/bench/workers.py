"""Two workers beside one: tiles per second of a cost map that `joulemap worker` processes make, a thread each."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path

from joulemap.service.storage.store import Store
from tests.bench.maps import ROBOT, terrain
from tests.bench.timing import Row
from tests.service.test_restart import free_port
from tests.service.workers import postgres, postgres_programs

CELLS = 2304
WORKERS = (1, 2)


def bench_workers() -> list[Row]:
    """Seconds until nine tenths of the tiles are done, from the moment all workers stand ready."""
    rows: list[Row] = []
    database = postgres(free_port()) if postgres_programs() else nullcontext(None)
    with tempfile.TemporaryDirectory() as folder, database as url:
        store = Store(Path(folder), url or f"sqlite:///{folder}/joulemap.db")
        store.open()
        heightmap_id = store.add_heightmap(terrain(CELLS, 1.0), name="terrain", stats={}).id
        alone = 0.0
        for count in WORKERS:
            took = _seconds(store, Path(folder), url, heightmap_id, count)
            alone = alone or took
            load = f"load of the machine {os.getloadavg()[0]:.1f}"
            words = f"{'PostgreSQL' if url else 'SQLite'}, {count} worker(s), {alone / took:.2f} times one ({load})"
            rows.append((f"{CELLS} x {CELLS}", words, took, "one worker", took / alone))
        store.close()
    return rows


def _seconds(store: Store, folder: Path, url: str | None, heightmap_id: str, count: int) -> float:
    one_thread = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    place = {"JOULEMAP_DATA_DIR": str(folder), **({"JOULEMAP_DATABASE_URL": url} if url else {})}
    command = [sys.executable, "-c", "from joulemap.service.cli import main; main()", "worker"]
    with ExitStack() as stack:
        workers = []
        for _ in range(count):
            process = subprocess.Popen(
                command, env={**os.environ, **one_thread, **place}, stdout=subprocess.PIPE, text=True
            )
            workers.append(stack.enter_context(process))
            stack.callback(process.kill)
        for process in workers:
            assert process.stdout is not None
            assert process.stdout.readline(), "a worker did not start"
        request = {"robot": ROBOT.as_dict(), "model": "default", "spacing_m": 1.0, "headings": 16}
        costmap_id = store.add_costmap(heightmap_id, request).id
        began = time.perf_counter()
        while (row := store.costmap(costmap_id)).progress < 0.9:
            assert row.problem is None, row.problem
            time.sleep(0.02)
        took = time.perf_counter() - began
    store.delete_costmap(costmap_id)
    return took
