"""`python -m tests.load --stalled 4000 --streams 4000`: clients that hold their connections, and how fast probes are.

A process opens so many connections that ask for a large file of the page and never read, and so many that follow a job.
With `--again S`, what the service closes is opened again after so many seconds. Another process asks `/healthz`
meanwhile, each time over a new connection from the same address. One request a second of another address says whether
others are still answered.
"""

from __future__ import annotations

import argparse
import asyncio
import http.client
import json
import math
import os
import random
import resource
import select
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.http.routes.page import plotly_version
from tests.bench.maps import terrain
from tests.load import Connection, Server, until_ready

_FILE = f"/page/plotly/{plotly_version()}/plotly.min.js"
_RECEIVE_BYTES = 2_048  # as small as the system lets it be
_PAUSE_S = 0.02
_OTHER = "127.0.0.99"


class Crowd:
    """Connections that are held, in a process of their own.

    Parameters
    ----------
    port : int
        Of the service.
    wanted : dict of str to int
        How many connections by the path that is asked for.
    addresses : int
        From how many addresses of the loopback network they come.
    rate : float
        Most connections that are opened in a second [1/s].
    again_s : float
        After which one that was closed is opened again [s]; 0: never.
    """

    def __init__(self, port: int, wanted: dict[str, int], *, addresses: int, rate: float, again_s: float) -> None:
        self._port, self._addresses, self._rate, self._again_s = port, addresses, rate, again_s
        self._poll = select.epoll()
        self._held: dict[int, tuple[socket.socket, str]] = {}
        paths = [path for path, count in wanted.items() for _ in range(count)]
        random.Random(0).shuffle(paths)
        self._to_open = deque((0.0, path) for path in paths)
        self.seen: Counter[str] = Counter()

    def hold(self, until: float) -> None:
        """Open what is to be held, and open again what is closed, until a time."""
        opened, began = 0, time.monotonic()
        while (now := time.monotonic()) < until:
            while self._to_open and self._to_open[0][0] < now and opened < self._rate * (now - began):
                self._open(self._to_open.popleft()[1], opened)
                opened += 1
            for number, event in self._poll.poll(0.05):
                self._happened(number, event)
            self.seen["most held"] = max(self.seen["most held"], len(self._held))
        self.seen["opened"] = opened

    def _open(self, path: str, count: int) -> None:
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        try:
            connection.bind((f"127.0.0.{1 + count % self._addresses}", 0))
            connection.settimeout(1.0)
            connection.connect(("127.0.0.1", self._port))
            connection.send(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        except OSError as error:
            self.seen[f"not opened: {type(error).__name__}"] += 1
            connection.close()
            self._closed(path)
            return
        connection.setblocking(False)
        self._held[connection.fileno()] = connection, path
        self._poll.register(connection, select.EPOLLRDHUP | (0 if path == _FILE else select.EPOLLIN))

    def _happened(self, number: int, event: int) -> None:
        connection, path = self._held[number]
        try:
            data = connection.recv(1_000)
        except OSError:
            data = b""
        if data.startswith(b"HTTP/1.1 "):
            self.seen[f"{'stalled' if path == _FILE else 'stream'} {data[9:12].decode()}"] += 1
        if not data or event & (select.EPOLLRDHUP | select.EPOLLHUP | select.EPOLLERR):
            self._poll.unregister(connection)
            connection.close()
            del self._held[number]
            self._closed(path)

    def _closed(self, path: str) -> None:
        self.seen["closed"] += 1
        if self._again_s:
            self._to_open.append((time.monotonic() + self._again_s, path))


def _ask(port: int, path: str, address: str = "127.0.0.1") -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0, source_address=(address, 0))
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        answer.read()
    finally:
        connection.close()
    return answer.status


def _probe(port: int, seconds: float) -> dict[str, Any]:
    """Times of /healthz [ms], and the statuses of it, of the other probes, and of an ordinary request of another."""
    times, statuses = [], {name: Counter[str]() for name in ("/healthz", "/readyz", "/metrics", "/v1")}

    def _one(path: str, address: str = "127.0.0.1") -> None:
        try:
            status = str(_ask(port, path, address))
        except OSError as error:
            status = type(error).__name__
        statuses[path][status] += 1

    until, rarely = time.monotonic() + seconds, 0.0
    while time.monotonic() < until:
        began = time.perf_counter()
        _one("/healthz")
        times.append(1e3 * (time.perf_counter() - began))
        if time.monotonic() > rarely:
            rarely = time.monotonic() + 1.0
            _one("/readyz")
            _one("/metrics")
            _one("/v1", _OTHER)
        time.sleep(_PAUSE_S)
    p50, p99 = np.percentile(times, (50, 99))
    return {"count": len(times), "p50_ms": p50, "p99_ms": p99, "max_ms": max(times), "statuses": statuses}


async def _followed(server: Server) -> str:
    """The path of the events of a job that nobody does."""
    connection = Connection(server.port)
    await until_ready(server, connection)
    data = write_geotiff(None, terrain(30, 1.0))
    assert data is not None
    status, answer = await connection.ask("POST", "/v1/heightmaps", data, "Content-Type: application/octet-stream\r\n")
    assert status == 201, answer[:500]
    asked = json.dumps({"heightmap_id": json.loads(answer)["id"], "model": "physics"}).encode()
    status, answer = await connection.ask("POST", "/v1/costmaps", asked)
    assert status == 202, answer[:500]
    return f"/v1/costmaps/{json.loads(answer)['id']}/events"


def _in_a_process(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tests.crowd", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE)


def _found(process: subprocess.Popen[bytes]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(process.communicate()[0])
    return found


def _told(name: str, found: dict[str, Any]) -> str:
    times = f"p50 {found['p50_ms']:.1f} ms, p99 {found['p99_ms']:.1f} ms, max {found['max_ms']:.1f} ms"
    return f"{name:22} /healthz {found['count']:5} times: {times}; statuses {found['statuses']}"


def measure(folder: Path, options: argparse.Namespace, settings: dict[str, str]) -> dict[str, Any]:
    """Print how fast probes are with and without the crowd; the figures."""
    server = Server(folder, {"JOULEMAP_WORKERS": "0", **settings})
    found = {}
    try:
        events = asyncio.run(_followed(server))
        third = options.seconds / 3.0
        found["alone"] = _found(_in_a_process("probe", server.port, third))
        cpu_s = server.cpu_s()
        wanted = json.dumps({_FILE: options.stalled, events: options.streams})
        crowd = _in_a_process(
            "crowd", server.port, options.seconds, wanted, options.addresses, options.rate, options.again
        )
        found["while they come"] = _found(_in_a_process("probe", server.port, third))
        found["while they are there"] = _found(_in_a_process("probe", server.port, third))
        found["cpu_s"] = server.cpu_s() - cpu_s
        found["memory_mb"] = server.memory_mb()[0]
        found["crowd"] = _found(crowd)
        found["afterwards"] = _found(_in_a_process("probe", server.port, third))
    finally:
        server.stop()
    for name in ("alone", "while they come", "while they are there", "afterwards"):
        print(_told(name, found[name]))
    print(f"the crowd: {found['crowd']}")
    print(
        f"the service held {found['memory_mb']:.0f} MB and computed for {found['cpu_s']:.1f} s; load of the machine "
        f"{os.getloadavg()[0]:.1f}"
    )
    return found


def main() -> None:
    kind, port, seconds, *more = sys.argv[1:]
    if kind == "probe":
        print(json.dumps(_probe(int(port), float(seconds))))
        return
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    wanted, addresses, rate, again_s = more
    crowd = Crowd(int(port), json.loads(wanted), addresses=int(addresses), rate=float(rate), again_s=float(again_s))
    crowd.hold(time.monotonic() + math.ceil(float(seconds)))
    print(json.dumps(crowd.seen))


if __name__ == "__main__":
    main()
