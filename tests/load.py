"""`python -m tests.load`: many clients ask a service of its own for paths, verdicts and readiness, and say how fast.

The service runs in a process of its own on a fresh data directory (or one that is kept with `--data-dir`), with one
cost map of hills. The clients share this process. Other work on the machine makes the times longer, so the processor
time of the service is printed beside them. So is how late a process was that does nothing but sleep: where it was as
late as the event loop, the machine made them wait.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.terrain.writers import write_geotiff
from tests.bench.maps import terrain

_TICK_HZ = os.sysconf("SC_CLK_TCK")
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_STALLS_MS = (25, 50, 100)
_SLEEPER = """
import sys, time
until, counts = time.monotonic() + float(sys.argv[1]), [0] * len(sys.argv[2:])
while (began := time.monotonic()) < until:
    time.sleep(0.01)
    late_ms = 1e3 * (time.monotonic() - began - 0.01)
    counts = [count + (late_ms > float(bound)) for count, bound in zip(counts, sys.argv[2:])]
print(*counts)
"""


class Connection:
    """One connection that is kept open, as that of a robot; no more of HTTP than a loopback measurement needs."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, method: str, path: str, body: bytes = b"", headers: str = "") -> tuple[int, bytes]:
        """The status and the body of the answer; a connection that was closed while it was idle is opened again."""
        kept = self._streams is not None
        try:
            return await self._asked(method, path, body, headers)
        except (ConnectionError, asyncio.IncompleteReadError) as error:
            self.close()
            if not kept or getattr(error, "partial", b""):
                raise
        return await self._asked(method, path, body, headers)

    async def _asked(self, method: str, path: str, body: bytes, headers: str) -> tuple[int, bytes]:
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self._port)
        reader, writer = self._streams
        kind = "" if "Content-Type" in headers else "Content-Type: application/json\r\n"
        head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{kind}{headers}Content-Length: {len(body)}\r\n\r\n"
        writer.write(head.encode() + body)
        answer = await reader.readuntil(b"\r\n\r\n")
        length = int(re.search(rb"(?i)content-length: (\d+)", answer)[1])  # type: ignore[index]
        content = await reader.readexactly(length)
        if b"\r\nconnection: close" in answer.lower():
            self.close()
        return int(answer[9:12]), content

    def close(self) -> None:
        """Hang up."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


@dataclass
class Seen:
    """What one kind of question saw."""

    name: str
    seconds: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    refusals: Counter[str] = field(default_factory=Counter)

    def saw(self, status: int, content: bytes) -> int:
        """Note why something was refused; the status."""
        if status >= 400:
            self.refusals[json.loads(content)["detail"]] += 1
        return status

    def summary(self, duration_s: float) -> dict[str, Any]:
        """Rate, percentiles [ms] and statuses."""
        found = np.array(self.seconds or [np.nan])
        p50, p90, p99 = 1e3 * np.percentile(found, (50, 90, 99))
        return {
            "question": self.name,
            "answers": len(self.seconds),
            "per_s": len(self.seconds) / duration_s,
            "p50_ms": p50,
            "p90_ms": p90,
            "p99_ms": p99,
            "max_ms": 1e3 * found.max(),
            "p99_by_p50": p99 / p50,
            "statuses": dict(self.statuses),
            "refusals": dict(self.refusals),
        }


class Server:
    """A service in a process of its own."""

    def __init__(self, folder: Path, settings: dict[str, str]) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._log = (folder / "server.log").open("w")
        command = [sys.executable, "-m", "joulemap.service.cli", "serve", "--port", str(self.port)]
        env = {**os.environ, "JOULEMAP_DATA_DIR": str(folder / "data"), **settings}
        self.process = subprocess.Popen(command, env=env, stdout=self._log, stderr=self._log)

    def stop(self) -> float:
        """End it as an operator would; the seconds that it took."""
        began = time.perf_counter()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(60)
        self._log.close()
        return time.perf_counter() - began

    def family(self) -> list[int]:
        """Its process id, then those of its descendants."""
        parents = {}
        for place in Path("/proc").glob("[0-9]*/stat"):
            try:
                values = place.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(place.parent.name)] = int(values[1])
        found = [self.process.pid]
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
        return found

    def cpu_s(self) -> float:
        """Processor time of the server itself so far [s]."""
        values = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(values[11]) + int(values[12])) / _TICK_HZ

    def memory_mb(self) -> tuple[float, float]:
        """Memory that the server itself holds, and that its workers and readers hold besides [MB]."""
        own, *others = (_resident_mb(pid) for pid in self.family())
        return own, sum(others)


def _resident_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_BYTES / 1e6
    except OSError:  # it has ended
        return 0.0


def _stolen_s() -> float:
    """Processor time that the host of this virtual machine took so far [s]: nobody here makes such stalls."""
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / _TICK_HZ


async def until_ready(server: Server, connection: Connection, deadline_s: float = 900.0) -> None:
    deadline = time.monotonic() + deadline_s
    while time.monotonic() < deadline and server.process.poll() is None:
        try:
            if (await connection.ask("GET", "/readyz"))[0] == 200:
                return
        except (OSError, asyncio.IncompleteReadError):
            connection.close()
        await asyncio.sleep(0.2)
    raise RuntimeError("the service is not ready: see server.log in its folder")


async def _made(connection: Connection, heightmap_id: str, wait_s: int = 300) -> str:
    asked = json.dumps({"heightmap_id": heightmap_id, "model": "physics"}).encode()
    status, answer = await connection.ask("POST", "/v1/costmaps", asked, f"Prefer: wait={wait_s}\r\n")
    assert status == 201, answer[:500]
    return str(json.loads(answer)["id"])


async def _cost_map(connection: Connection, cells: int) -> tuple[str, str]:
    """The newest cost map, made where there is none, and its heightmap."""
    known = json.loads((await connection.ask("GET", "/v1/costmaps?limit=1000"))[1])["items"]
    for item in known:
        if item["status"] == "done" and item["frame"]["cols"] == cells:
            return item["id"], item["heightmap_id"]
    data = write_geotiff(None, terrain(cells, 1.0))
    assert data is not None
    raw = "Content-Type: application/octet-stream\r\n"
    status, answer = await connection.ask("POST", "/v1/heightmaps", data, raw)
    assert status == 201, answer[:500]
    heightmap_id = json.loads(answer)["id"]
    return await _made(connection, heightmap_id), heightmap_id


async def _stalls(server: Server) -> dict[float, float]:
    """How many pauses on the event loop were too long by at most so many seconds, so far."""
    text = (await Connection(server.port).ask("GET", "/metrics"))[1].decode()
    found = re.findall(r'^joulemap_event_loop_stall_seconds_bucket{le="(\S+)"} (\S+)', text, re.MULTILINE)
    return {float(bound): float(count) for bound, count in found}


async def _repeat(seen: Seen, until: float, ask: Callable[[], Awaitable[int]], pause_s: float = 0.0) -> None:
    while time.perf_counter() < until:
        began = time.perf_counter()
        status = await ask()
        seen.statuses[status] += 1
        seen.seconds.append(time.perf_counter() - began)
        if pause_s:
            await asyncio.sleep(pause_s)


def _point(cells: int, chance: random.Random) -> list[float]:
    return [round(chance.uniform(1.0, cells - 1.0), 2) for _ in range(2)]


async def _begun(server: Server, place: str, route: list[list[float]]) -> tuple[Connection, str]:
    """A connection, and the address of the updates of a drive that was begun over it."""
    client = Connection(server.port)
    status, answer = await client.ask("POST", f"{place}/drives", json.dumps({"path": route}).encode())
    assert status == 201, answer[:500]
    return client, f"/v1/drives/{json.loads(answer)['id']}/updates"


async def _follow(
    client: Connection, url: str, route: list[list[float]], seen: Seen, until: float, chance: random.Random
) -> None:
    """A robot that drives along a route at 0.5 m/s and sends a sample a second."""
    along, sent = np.append(0.0, np.cumsum(np.hypot(*np.diff(route, axis=0).T))), 0
    await asyncio.sleep(chance.uniform(0.0, 1.0))

    async def _update() -> int:
        nonlocal sent
        position = [float(np.interp(0.5 * sent, along, axis)) for axis in np.transpose(route)]
        sample = {"time_s": float(sent), "position": position, "power_w": chance.uniform(50.0, 90.0)}
        sent += 1
        return seen.saw(*await client.ask("POST", url, json.dumps({"samples": [sample]}).encode()))

    await _repeat(seen, until, _update, 1.0)


async def _attack(server: Server, options: argparse.Namespace) -> dict[str, Any]:
    first = Connection(server.port)
    await until_ready(server, first)
    costmap, heightmap = await _cost_map(first, options.cells)
    chance = random.Random(options.seed)
    place = f"/v1/costmaps/{costmap}"

    def _question() -> bytes:
        start, goal = (_point(options.cells, chance) for _ in range(2))
        while options.near and math.dist(start, goal) > options.near:
            start, goal = (_point(options.cells, chance) for _ in range(2))
        ends = {"start": start, "goal": goal}
        return json.dumps({**ends, "snap": True, "refine": options.refine, **options.change}).encode()

    status, answer = await first.ask("POST", f"{place}/paths", _question())
    assert status == 200, answer[:500]
    route = [point[:2] for point in json.loads(answer)["path"]]
    seen = {name: Seen(name) for name in ("paths", "positions", "drives", "readyz", "healthz")}
    drives = [await _begun(server, place, route) for _ in range(options.drives)]  # before what is measured
    until = time.perf_counter() + options.seconds
    cpu, stolen, began, stalls = server.cpu_s(), _stolen_s(), time.perf_counter(), await _stalls(server)
    sleeper = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _SLEEPER, str(options.seconds), *map(str, _STALLS_MS), stdout=asyncio.subprocess.PIPE
    )
    tasks: list[Awaitable[None]] = []
    for _ in range(options.clients):
        client = Connection(server.port)

        async def _path(client: Connection = client) -> int:
            return seen["paths"].saw(*await client.ask("POST", f"{place}/paths", _question()))

        tasks.append(_repeat(seen["paths"], until, _path))
    for _ in range(options.robots):
        client = Connection(server.port)

        async def _position(client: Connection = client) -> int:
            at = chance.randrange(len(route) - 1)
            task = {"path": route[at:], "battery": {"charge": 0.6, "reserve": 0.2}}
            return seen["positions"].saw(*await client.ask("POST", f"{place}/feasibility", json.dumps(task).encode()))

        tasks.append(_repeat(seen["positions"], until, _position))
    tasks += [_follow(*drive, route, seen["drives"], until, chance) for drive in drives]
    for name in ("readyz", "healthz"):
        client = Connection(server.port)

        async def _probe(client: Connection = client, name: str = name) -> int:
            return seen[name].saw(*await client.ask("GET", f"/{name}"))

        tasks.append(_repeat(seen[name], until, _probe, 0.05))
    memory: list[tuple[float, float]] = []

    async def _watch() -> None:
        said = 0.0
        while (now := time.perf_counter()) < until:
            memory.append(server.memory_mb())
            if options.every and now - began >= said:
                said += options.every
                own, others = memory[-1]
                count = len(seen["paths"].seconds)
                print(f"{now - began:6.0f} s  {own:6.0f} MB, its workers {others:6.0f} MB, {count:6} paths", flush=True)
            await asyncio.sleep(1.0)

    tasks.append(_watch())
    built = Seen("a cost map is built")
    if options.build:
        builder = Connection(server.port)

        async def _build() -> int:
            await _made(builder, heightmap)
            return 201

        tasks.append(_repeat(built, until, _build))
        seen["build"] = built
    await asyncio.gather(*tasks)
    duration = time.perf_counter() - began
    after = await _stalls(server)
    stalls = {bound: after[bound] - stalls[bound] for bound in after}
    slept = (await sleeper.communicate())[0].split()
    quarters = [np.median(part, axis=0).tolist() for part in np.array_split(np.array(memory), 4)]
    return {
        "questions": [one.summary(duration) for one in seen.values() if one.seconds],
        "seconds": duration,
        "cpu_share": (server.cpu_s() - cpu) / duration,
        "cpu_ms_per_path": 1e3 * (server.cpu_s() - cpu) / max(len(seen["paths"].seconds), 1),
        "stalls": {f"{1e3 * bound:g} ms": max(stalls.values()) - count for bound, count in stalls.items()},
        "sleeper": {f"{bound:g} ms": int(count) for bound, count in zip(_STALLS_MS, slept, strict=True)},
        "stolen_s": _stolen_s() - stolen,
        "memory_mb": quarters,
        "load": os.getloadavg()[0],
    }


def _told(found: dict[str, Any]) -> str:
    lines = []
    for one in found["questions"]:
        lines.append(
            f"{one['question']:20} {one['answers']:6} answers {one['per_s']:7.1f}/s  p50 {one['p50_ms']:7.1f} ms  "
            f"p90 {one['p90_ms']:7.1f}  p99 {one['p99_ms']:7.1f} ({one['p99_by_p50']:.1f} x p50)  "
            f"max {one['max_ms']:7.1f}  {one['statuses']}"
        )
        lines += [f"  {count} times: {words}" for words, count in one["refusals"].items()]
    stalls = {bound: round(found["stalls"][bound]) for bound in found["sleeper"]}
    lines.append(
        f"server: {found['cpu_share']:.2f} cores, {found['cpu_ms_per_path']:.0f} ms of processor a path; stalls of the "
        f"event loop longer than {stalls}, of a process that only sleeps {found['sleeper']}; load of the machine "
        f"{found['load']:.1f}, "
        f"{found['stolen_s']:.2f} s taken by its host"
    )
    for name, medians in zip(("the service", "its workers"), zip(*found["memory_mb"], strict=True), strict=True):
        lines.append(f"memory of {name}, median by quarter: {' -> '.join(f'{mb:.0f}' for mb in medians)} MB")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=64, help="clients that ask for paths between random places")
    parser.add_argument("--robots", type=int, default=0, help="robots that ask from their position along a route")
    parser.add_argument(
        "--drives", type=int, default=0, help="robots whose drives are followed, a sample a second each"
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cells", type=int, default=1000, help="cells along a side, 1 m each")
    parser.add_argument("--no-refine", dest="refine", action="store_false", help="paths over grid moves only")
    parser.add_argument("--near", type=float, metavar="M", help="only goals that are at most so far from their start")
    parser.add_argument("--change", type=json.loads, default={}, metavar="JSON", help="more fields of each question")
    parser.add_argument("--build", action="store_true", help="build cost maps of the same heightmap meanwhile")
    parser.add_argument("--every", type=float, default=0.0, metavar="S", help="print the memory every so many seconds")
    parser.add_argument("--data-dir", type=Path, help="keep the cost map here for the next time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hog", type=int, default=0, help="instead: small questions beside so many of another key")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE", help="settings of the service: JOULEMAP_...=...")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.data_dir or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        settings = dict(pair.split("=", 1) for pair in options.settings)
        if options.hog:
            from tests import hog  # which imports this module

            found = hog.measure(folder, options, settings)
            if options.json:
                options.json.write_text(json.dumps(found, indent=1))
            return
        server = Server(folder, settings)
        try:
            found = asyncio.run(_attack(server, options))
        finally:
            found_s = server.stop()
    print(_told(found))
    print(f"the service ended {found_s:.1f} s after SIGTERM")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
