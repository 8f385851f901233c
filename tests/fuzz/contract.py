"""`python -m tests.fuzz.contract --requests 20000`: Schemathesis with all its checks, on a service with some content.

The service has a heightmap, a finished cost map, runs and a finished calibration, whose ids the requests have. Jobs
that are asked for wait: nobody makes them, so that the machine is free for answers.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.route_planner import SAMPLING_PLANNERS
from tests.fuzz.contract_hooks import KNOWN
from tests.load import Server
from tests.service.conftest import GOAL, START, hill
from tests.service.test_calibrations import ROBOT, hills, run_csv
from tests.service.workers import ROOT

_LIMITS = {"JOULEMAP_MAX_CELLS": "100000", "JOULEMAP_MAX_LATTICE_VALUES": "200000", "JOULEMAP_QUEUE_SIZE": "1000000"}
_WAIT = {"Prefer": "wait=100"}
_CONFIG = """
continue-on-failure = true
request-timeout = 60.0
max-stream-events = 3
headers = { Prefer = "respond-async" }
warnings = false
cache.enabled = false

[checks]
# what the schema cannot say is said with 413 or 422: a place outside the map, a robot that is another one, ...
positive_data_acceptance.expected-statuses = ["2xx", "404", "409", "413", "415", "422"]

negative_data_rejection.expected-statuses = ["400", "401", "403", "404", "405", "406", "409", "413", "415", "422"]

[phases.stateful]
enabled = false

[phases.examples]
enabled = false
"""


def known_ids(url: str) -> dict[str, Any]:
    """Make one of everything; ids by name of the path's parameter."""
    with httpx.Client(base_url=url, timeout=200.0, headers=_WAIT) as client:

        def _post(path: str, **what: Any) -> dict[str, Any]:
            answer = client.post(path, **what)
            assert answer.is_success, answer.text
            return answer.json()  # type: ignore[no-any-return]

        heightmap = _post("/v1/heightmaps", content=write_geotiff(None, hill()))["id"]
        costmap = _post("/v1/costmaps", json={"heightmap_id": heightmap, "model": "physics"})["id"]
        ground = _post("/v1/heightmaps", content=write_geotiff(None, hills()))["id"]
        files = [("file", (f"run_{k}.csv", run_csv(k, metres=60.0))) for k in range(3)]
        runs = _post("/v1/runs", files=files)["id"]
        asked = {"heightmap_id": ground, "runs": [runs], "model": "physics", "robot": ROBOT, "quick": True}
        calibration = _post("/v1/calibrations", json=asked)
        deadline = time.monotonic() + 200.0
        while (about := client.get(f"/v1/calibrations/{calibration['id']}").json())["status"] != "done":
            assert about["status"] in ("queued", "running"), about
            assert time.monotonic() < deadline, about
            time.sleep(0.5)
    return {"heightmap_id": heightmap, "costmap_id": costmap, "runs_id": runs, "calibration_id": calibration["id"]}


def ready(server: Server) -> str:
    """The URL of a server that is ready."""
    url, deadline = f"http://127.0.0.1:{server.port}", time.monotonic() + 200.0
    while True:
        try:
            if httpx.get(f"{url}/readyz").status_code == 200:
                return url
        except httpx.TransportError:
            pass
        assert server.process.poll() is None, "the service has ended"
        assert time.monotonic() < deadline, "the service is not ready"
        time.sleep(0.2)


def run(url: str, known: dict[str, Any], folder: Path, options: argparse.Namespace, seed: int) -> tuple[int, int]:
    """One run of Schemathesis: the number of its requests, and its exit code."""
    (folder / "schemathesis.toml").write_text(_CONFIG)
    report = folder / f"report-{seed}.ndjson"
    command = [str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(folder / "schemathesis.toml")]
    command += ["run", f"{url}/openapi.json", "--exclude-method", "DELETE", "--checks", "all", "--no-shrink"]
    command += ["--seed", str(seed), "--max-examples", str(options.examples), "--workers", str(options.workers)]
    command += ["--report", "ndjson", "--report-ndjson-path", str(report)]
    if options.paths:
        command += ["--include-path-regex", "|".join(options.paths)]
    env = {**os.environ, "SCHEMATHESIS_HOOKS": "tests.fuzz.contract_hooks", KNOWN: json.dumps(known)}
    ended = subprocess.run(command, env={**env, "PYTHONPATH": str(ROOT)}, cwd=folder, stdout=subprocess.PIPE, text=True)
    told = ended.stdout
    (folder / f"told-{seed}.txt").write_text(told)
    if ended.returncode:
        print(told, flush=True)
    counts = Counter(re.findall(r'"status_code":\s*(\d+)', report.read_text() if report.exists() else told))
    print(f"seed {seed}: {counts.total()} requests {dict(counts)}, exit code {ended.returncode}", flush=True)
    return counts.total(), ended.returncode


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.contract", description=__doc__)
    parser.add_argument("--requests", type=int, default=20_000, help="at least so many; the run is repeated until then")
    parser.add_argument("--examples", type=int, default=100, help="most generated requests of an operation in one run")
    parser.add_argument("--paths", nargs="*", default=[], metavar="REGEX", help="these paths only")
    # more than one thread in CPython 3.11's parser at a time ends some of Schemathesis' own work
    parser.add_argument("--workers", type=int, default=1, help="requests at a time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="where data, log and reports stay")
    options = parser.parse_args()
    sent = failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        began, server = time.monotonic(), Server(folder, {**_LIMITS, "JOULEMAP_WORKERS": "1"})
        try:
            known = known_ids(ready(server))
        finally:
            server.stop()
        server = Server(folder, {**_LIMITS, "JOULEMAP_WORKERS": "0"})
        try:
            url, seed = ready(server), options.seed
            known |= {"start": START, "goal": GOAL, "planners": list(SAMPLING_PLANNERS)}
            while sent < options.requests:
                count, code = run(url, known, folder, options, seed)
                sent, failed, seed = sent + count, failed + (code != 0), seed + 1
                assert count, "nothing was sent"
        finally:
            server.stop()
    print(f"{sent} requests in {time.monotonic() - began:.0f} s; {failed} runs failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
