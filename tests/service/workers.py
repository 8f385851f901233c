"""Cost maps made without a cluster, and a PostgreSQL of one's own, for tests of jobs that several processes do."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.jobs.costmaps import order_of
from joulemap.service.storage.store import Store
from joulemap.service.work.tiles import build, finish, lay_out

ROOT = Path(__file__).resolve().parents[2]


def rolling(metres: int = 190) -> Heightmap:
    """Half-metre cells, a lake of unknown heights in it."""
    y, x = np.mgrid[0 : 2 * metres, 0 : 2 * metres + 30] * 0.5
    heights = 0.8 * np.sin(0.1 * x) + 0.6 * np.cos(0.07 * y + 0.1 * x)
    heights[40:90, 200:260] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(500_000.0, 4_000_190.0, 0.5, *heights.shape, "EPSG:32630"))


def asked(store: Store, heightmap_id: str) -> str:
    """A cost map of physics that waits."""
    request = {"robot": Robot().as_dict(), "model": "physics", "spacing_m": 1.0, "headings": 8}
    return store.add_costmap(heightmap_id, request).id


def made_here(store: Store, costmap_id: str, models_dir: Path) -> dict[str, Any]:
    """Make a cost map in this process, without a cluster; what came out."""
    order = order_of(store, costmap_id, models_dir)
    for number in lay_out(order)[1]:
        build(order, number)
    summary = finish(order)
    store.finish(costmap_id, summary)
    store.tidy(costmap_id)
    return summary


def until(condition, timeout_s: float = 240.0) -> None:  # type: ignore[no-untyped-def]
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def fingerprint(folder: Path) -> str:
    """SHA-256 over every array of a lattice, bit by bit."""
    digest = hashlib.sha256()
    group = zarr.open_group(folder, mode="r")
    for name, array in sorted(group.arrays()):
        digest.update(name.encode() + np.ascontiguousarray(array[...]).tobytes())
    return digest.hexdigest()


def postgres_programs() -> Path | None:
    """The folder of Debian's PostgreSQL programs, None where it is not installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    return found[-1].parent if found and shutil.which("runuser") else None


class Postgres:
    """A fresh PostgreSQL that listens on this machine alone. url : of its database."""

    def __init__(self, home: Path, port: int) -> None:
        self.url = f"postgresql+psycopg://postgres@127.0.0.1:{port}/postgres"
        self._home, self._options = home, f"-p {port} -k {home} -c listen_addresses=127.0.0.1"

    def call(self, program: str, *arguments: str) -> None:
        programs = postgres_programs()
        assert programs is not None
        as_postgres = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []  # it refuses to run as root
        command = [*as_postgres, str(programs / program), "-D", str(self._home / "data"), *arguments]
        subprocess.run(command, check=True, capture_output=True, cwd="/")

    def start(self) -> None:
        self.call("pg_ctl", "-w", "-l", str(self._home / "log"), "-o", self._options, "start")

    def stop(self) -> None:
        self.call("pg_ctl", "-w", "-m", "immediate", "stop")

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop all its processes without ending them."""
        first = int((self._home / "data" / "postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{first}/task/{first}/children").read_text().split()
        processes = [first, *map(int, children)]
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in processes:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGCONT)


@contextmanager
def postgres(port: int) -> Iterator[str]:
    """The URL of a fresh PostgreSQL."""
    with postgres_server(port) as server:
        yield server.url


@contextmanager
def postgres_server(port: int) -> Iterator[Postgres]:
    """A PostgreSQL that runs, and is removed in the end."""
    home = Path(tempfile.mkdtemp(prefix="joulemap-postgres-"))
    if os.geteuid() == 0:
        shutil.chown(home, "postgres", "postgres")
    server = Postgres(home, port)
    try:
        server.call("initdb", "-A", "trust", "-U", "postgres")
        server.start()
        try:
            yield server
        finally:
            with suppress(subprocess.CalledProcessError):  # a test may have stopped it
                server.stop()
    finally:
        shutil.rmtree(home, ignore_errors=True)
