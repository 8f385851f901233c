"""`python -m tests.kills`: services, workers and scheduler are killed (signal 9) at random moments while jobs run.

Whatever was acknowledged must be there in the end: every heightmap the same, every job done, every lattice the same to
the bit, and no unfinished file after the next start.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx

from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CalibrationRow
from joulemap.service.work.calibrations import REPORT
from tests.service.clusters import free_port
from tests.service.preload import disturb, disturbed
from tests.service.test_calibrations import ROBOT, hills, run_csv
from tests.service.test_restart import SERVE, workers_of
from tests.service.workers import ROOT, asked, fingerprint, made_here, postgres_server, rolling

TILE_CELLS, PAUSE_S = 48, 0.05
MOST_JOBS = 3
CALIBRATIONS = 0.02
"""Share of the steps at which one is asked for, where none waits."""
WAIT_S = 900.0


class Program:
    """A process that is started again whenever it was killed."""

    def __init__(self, name: str, command: list[str], env: dict[str, str], log: Path) -> None:
        self.name, self._command, self._env = name, command, {**os.environ, "PYTHONPATH": str(ROOT), **env}
        self._log = log.open("ab")
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(self._command, env=self._env, stdout=self._log, stderr=self._log)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class Load:
    """Heightmaps, cost maps, runs and calibrations that are asked for; only what was acknowledged counts."""

    def __init__(self, ports: list[int], tif: bytes, draw: random.Random) -> None:
        self._ports, self._tif, self._draw = ports, tif, draw
        self.heightmaps: dict[str, Any] = {}
        self.jobs: dict[str, str] = {}
        """Status by place."""

    def look(self) -> None:
        """Ask for the status of every job that has not ended."""
        for place, status in self.jobs.items():
            answer = self.call("GET", place) if status not in ("done", "failed") else None
            if answer is not None and answer.status_code < 500:
                assert answer.status_code == 200, f"{place} is lost: {answer.text}"
                self.jobs[place] = answer.json()["status"]

    def call(self, method: str, path: str, **how: Any) -> httpx.Response | None:
        """An answer of any service; None where it does not answer."""
        try:
            port = self._draw.choice(self._ports)
            return httpx.request(method, f"http://127.0.0.1:{port}{path}", timeout=10.0, **how)
        except httpx.TransportError:
            return None

    def step(self) -> None:
        """Ask for one more job where there are few, and look at the others."""
        self.look()
        waiting = [place for place, status in self.jobs.items() if status not in ("done", "failed")]
        if not any("calibrations" in place for place in waiting) and self._draw.random() < CALIBRATIONS:
            self._calibrate()
        if len(waiting) >= MOST_JOBS:
            return
        sent = self.call("POST", "/v1/heightmaps", content=self._tif)
        if sent is None or sent.status_code != 201:
            return
        heightmap = sent.json()
        self.heightmaps[heightmap["id"]] = heightmap
        body = {"heightmap_id": heightmap["id"], "model": "physics", "headings": 8}
        made = self.call("POST", "/v1/costmaps", json=body)
        if made is not None and made.status_code == 202:
            self.jobs[made.headers["location"]] = "queued"

    def _calibrate(self) -> None:
        ground = self.call("POST", "/v1/heightmaps", content=write_geotiff(None, hills()))
        if ground is None or ground.status_code != 201:
            return
        self.heightmaps[ground.json()["id"]] = ground.json()
        files = [("file", (f"run_{k}.csv", run_csv(k, metres=60.0))) for k in range(3)]
        runs = self.call("POST", "/v1/runs", files=files)
        if runs is None or runs.status_code != 201:
            return
        body = {"heightmap_id": ground.json()["id"], "runs": [runs.json()["id"]], "model": "physics", "robot": ROBOT}
        made = self.call("POST", "/v1/calibrations", json=body | {"quick": True})
        if made is not None and made.status_code == 202:
            self.jobs[made.headers["location"]] = "queued"


def run(folder: Path, *, kills: int, seed: int, with_cluster: bool) -> Counter[str]:
    """Kill so many times; what was killed how often. Raises AssertionError where anything was lost."""
    draw = random.Random(seed)
    tif = write_geotiff(None, rolling(95))
    assert tif is not None
    slow, killed = disturbed(tile_cells=TILE_CELLS, pause_s=PAUSE_S), Counter[str]()
    with ExitStack() as stack:
        ports, env, programs = [free_port()], dict(slow), []
        if with_cluster:
            ports.append(free_port())
            scheduler = f"127.0.0.1:{free_port()}"
            env["JOULEMAP_DATABASE_URL"] = stack.enter_context(postgres_server(free_port())).url
            env["JOULEMAP_SCHEDULER"] = f"tcp://{scheduler}"
            dask = [sys.executable, "-m", "dask"]
            host, port = scheduler.split(":")
            at = ["scheduler", "--host", host, "--port", port, "--no-dashboard"]
            programs.append(Program("scheduler", [*dask, *at], {}, folder / "scheduler.log"))
            one = ["worker", f"tcp://{scheduler}", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
            programs += [Program("worker", [*dask, *one], slow, folder / f"worker{n}.log") for n in (1, 2)]
        for port_number in ports:
            command = [sys.executable, "-c", SERVE, str(folder / "data"), str(port_number)]
            programs.append(Program("service", command, env, folder / f"service{port_number}.log"))
        load = Load(ports, tif, draw)
        try:
            _until(load, lambda: any(status == "running" for status in load.jobs.values()))
            while killed.total() < kills:
                deadline = time.monotonic() + draw.uniform(0.0, 4.0)
                while time.monotonic() < deadline:
                    load.step()
                    time.sleep(0.1)
                killed[_kill_one(programs, draw, load)] += 1
                for program in programs:
                    if program.process.poll() is not None:
                        program.start()
                if killed.total() % 10 == 0:
                    print(f"{killed.total()} kills {dict(killed)}, jobs {Counter(load.jobs.values())}", flush=True)
            for place in load.jobs:  # no job is asked for any more
                _until(load, lambda place=place: load.jobs[place] in ("done", "failed"), programs)
        finally:
            for program in programs:
                program.kill()
        _check(folder, load, env.get("JOULEMAP_DATABASE_URL"))
    kinds = Counter(place.split("/")[2] for place in load.jobs)
    print(f"acknowledged: {len(load.heightmaps)} heightmaps, {dict(kinds)}; none is lost", flush=True)
    return killed


def _kill_one(programs: list[Program], draw: random.Random, load: Load) -> str:
    program = draw.choice(programs)
    if len(programs) == 1 and draw.random() < 0.5:  # a worker of the service's own, once there is one
        deadline = time.monotonic() + WAIT_S
        while not (workers := workers_of(program.process.pid)):
            assert time.monotonic() < deadline, "the service has no workers"
            load.step()
            time.sleep(0.1)
        os.kill(draw.choice(workers), signal.SIGKILL)
        return "worker"
    program.kill()
    return program.name


def _until(load: Load, condition: Any, programs: list[Program] | None = None) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"it does not end: {load.jobs}"
        for program in programs or []:
            if program.process.poll() is not None:
                program.start()
        load.step() if programs is None else load.look()
        time.sleep(0.2)


def _check(folder: Path, load: Load, url: str | None) -> None:
    disturb(tile_cells=TILE_CELLS, pause_s=0.0, full=None)
    alone = Store(folder / "alone", f"sqlite:///{folder / 'alone.db'}")
    alone.open()
    costmap_id = asked(alone, alone.add_heightmap(rolling(95), name="rolling", stats={}).id)
    made_here(alone, costmap_id, folder)
    expected = fingerprint(alone.lattice_path(costmap_id))
    data = folder / "data"
    store = Store(data, url or f"sqlite:///{data / 'joulemap.db'}")
    store.open()
    for heightmap_id, sent in load.heightmaps.items():
        assert store.open_heightmap(heightmap_id).data_hash == sent["hash"], heightmap_id
    found = set()
    for place, status in load.jobs.items():
        kind, job_id = place.split("/")[2:]
        assert status == "done", f"{job_id}: {store.costmap(job_id).problem if kind == 'costmaps' else place}"
        if kind == "costmaps":
            assert fingerprint(store.lattice_path(job_id)) == expected, job_id
        else:
            report = json.loads((store.path(CalibrationRow, job_id) / REPORT).read_text(encoding="utf-8"))
            found.add(json.dumps([report["effects"], report["error"]], sort_keys=True))
            assert any((data / "models" / job_id).iterdir()), job_id
    assert len(found) <= 1, "calibrations of the same runs differ"
    left = [p for kind in ("*.partial", "*.tiles") for p in data.glob(f"*/{kind}")]
    left += list((data / "costmaps").rglob("*.partial"))
    assert not left, left
    store.close()
    assert not list((data / "uploads").iterdir())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cluster", action="store_true", help="two services, a scheduler, two workers and PostgreSQL")
    parser.add_argument("--folder", type=Path, help="where data and logs stay")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = options.folder or Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        print(run(place, kills=options.kills, seed=options.seed, with_cluster=options.cluster))


if __name__ == "__main__":
    main()
