"""The proxy of docker/nginx.conf: slow uploads and slow readers never reach the service, streams of events do."""

from __future__ import annotations

import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import httpx
import pytest

from joulemap.service.http.routes.page import plotly_version
from tests.service.clusters import ROOT, free_port
from tests.service.test_restart import SERVE, answers, wait_until

pytestmark = pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is not installed")

_CLIENTS = 40
_PATIENCE_S = 5


class Ports:
    """The ports of the proxy and of the service behind it."""

    def __init__(self) -> None:
        self.proxy, self.service = free_port(), free_port()

    def open_at_the_service(self) -> int:
        """How many connections the service has."""
        local = f":{self.service:04X}"
        rows = (line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
        return sum(row[1].endswith(local) and row[3] == "01" for row in rows)

    def connects(self, text: str) -> socket.socket:
        """A client that sends something and then neither sends nor reads."""
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2_048)
        client.connect(("127.0.0.1", self.proxy))
        client.sendall(f"{text}\r\nHost: localhost\r\n".encode())
        return client


@pytest.fixture(scope="module")
def ports(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ports]:
    """A service and its proxy, which waits for slow clients for a short time only."""
    folder, found = tmp_path_factory.mktemp("proxy"), Ports()
    text = (ROOT / "docker" / "nginx.conf").read_text()
    for old, new in (
        ("listen 8080", f"listen 127.0.0.1:{found.proxy}"),
        ("joulemap:8000", f"127.0.0.1:{found.service}"),
        ("/tmp/", f"{folder}/"),
        ("20s;", f"{_PATIENCE_S}s;"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "nginx.conf").write_text(f"user root;\n{text}" if os.getuid() == 0 else text)
    env = {**os.environ, "PYTHONPATH": str(ROOT), "JOULEMAP_TRUSTED_PROXIES": "127.0.0.1", "JOULEMAP_WORKERS": "0"}
    commands = (
        [sys.executable, "-c", SERVE, str(folder / "data"), str(found.service)],
        ["nginx", "-p", str(folder), "-c", str(folder / "nginx.conf"), "-g", "daemon off;"],
    )
    processes = [subprocess.Popen(command, env=env, cwd=ROOT) for command in commands]
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{found.proxy}") as http:
            wait_until(lambda: answers(http, "/readyz"))
        yield found
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            process.wait(30)


@pytest.fixture
def http(ports: Ports) -> Iterator[httpx.Client]:
    """A client at another address than the slow ones."""
    way = httpx.HTTPTransport(local_address="127.0.0.7")
    with httpx.Client(base_url=f"http://127.0.0.1:{ports.proxy}", transport=way, timeout=60.0) as client:
        yield client


def test_slow_uploads_stay_in_the_proxy_and_end(ports: Ports, http: httpx.Client) -> None:
    with ExitStack() as stack:
        slow = [stack.enter_context(closing(ports.connects("POST /v1/heightmaps HTTP/1.1"))) for _ in range(_CLIENTS)]
        for client in slow:
            client.sendall(b"Content-Type: application/octet-stream\r\nContent-Length: 1000000\r\n\r\nhalf of it")
        assert http.get("/v1/heightmaps").status_code == 200
        assert ports.open_at_the_service() <= 4  # those of this client and of the probe before
        for client in slow:
            client.settimeout(10 * _PATIENCE_S)
            _until_closed(client)


def test_slow_readers_hold_nothing_of_the_service(ports: Ports, http: httpx.Client) -> None:
    path = f"/page/plotly/{plotly_version()}/plotly.min.js"
    with ExitStack() as stack:
        slow = [stack.enter_context(closing(ports.connects(f"GET {path} HTTP/1.1"))) for _ in range(_CLIENTS)]
        for client in slow:
            client.sendall(b"\r\n")
        began = time.monotonic()
        wait_until(lambda: http.get("/v1").status_code == 200 and ports.open_at_the_service() <= 34)  # kept for reuse
        assert len(http.get(path).content) > 1_000_000
        assert time.monotonic() - began < 30.0


def test_one_address_has_so_many_connections_and_no_more(ports: Ports, http: httpx.Client) -> None:
    with ExitStack() as stack:
        many = [stack.enter_context(closing(ports.connects("POST /v1/runs HTTP/1.1"))) for _ in range(80)]
        for client in many:
            client.sendall(b"Content-Length: 1000\r\n\r\nx")
        wait_until(lambda: len(select.select(many, [], [], 0.0)[0]) == 16)  # of those that are let in, none is answered
        assert all(b" 429 " in client.recv(200) for client in select.select(many, [], [], 0.0)[0])
        assert http.get("/v1").status_code == 200


def test_a_stream_of_events_is_passed_on_as_it_comes(ports: Ports, http: httpx.Client, hill_tif: bytes) -> None:
    heightmap = http.post("/v1/heightmaps", content=hill_tif).json()["id"]
    place = http.post("/v1/costmaps", json={"heightmap_id": heightmap, "model": "physics"}).headers["location"]
    with http.stream("GET", f"{place}/events", headers={"Accept": "text/event-stream"}, timeout=10.0) as stream:
        assert any("queued" in line for line in stream.iter_lines())  # and no more comes, as nobody makes the map


def _until_closed(client: socket.socket) -> None:
    try:
        while client.recv(4_096):
            pass
    except ConnectionResetError:
        pass
