"""Clients that hold as many connections and event streams as they get: others are answered, and so is every probe."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import httpx
import pytest

from joulemap.service.http.routes.page import plotly_version
from tests.load import Server
from tests.service.test_restart import answers, ask, wait_until

FILE = f"/page/plotly/{plotly_version()}/plotly.min.js"
ALL, FEW, STREAMS, STALLED_S = 20, 8, 3, 3.0
PROXY, OTHER = "127.0.0.200", "127.0.0.2"


class Service(NamedTuple):
    folder: Path
    port: int
    events: str
    """Path of the events of a job that nobody does."""

    def client(self, address: str = "127.0.0.1", headers: dict[str, str] | None = None) -> httpx.Client:
        transport = httpx.HTTPTransport(local_address=address)
        return httpx.Client(
            base_url=f"http://127.0.0.1:{self.port}", transport=transport, headers=headers, timeout=30.0
        )

    def status(self, path: str = "/v1", address: str = "127.0.0.1", **headers: str) -> int:
        with self.client(address, headers) as client:
            return client.get(path).status_code

    def probes(self) -> set[int]:
        return {self.status(path) for path in ("/healthz", "/readyz", "/metrics")}


class Crowd(ExitStack):
    """Connections that ask and read nothing, or only the beginning."""

    def hold(
        self,
        service: Service,
        path: str,
        count: int,
        address: str = "127.0.0.1",
        headers: str = "",
        method: str = "GET",
    ) -> None:
        self.held: list[socket.socket] = []
        for _ in range(count):
            connection = self.enter_context(socket.socket())
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2_048)
            connection.settimeout(20.0)
            connection.bind((address, 0))
            connection.connect(("127.0.0.1", service.port))
            connection.sendall(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n".encode())
            self.held.append(connection)

    def statuses(self) -> Counter[int]:
        return Counter(int(connection.recv(12).split()[1]) for connection in self.held)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, hill_tif: bytes) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("crowded")
    server = Server(
        folder,
        {
            "JOULEMAP_MAX_CONNECTIONS": str(ALL),
            "JOULEMAP_CLIENT_CONNECTIONS": str(FEW),
            "JOULEMAP_CLIENT_STREAMS": str(STREAMS),
            "JOULEMAP_STALLED_S": str(STALLED_S),
            "JOULEMAP_TRUSTED_PROXIES": PROXY,
            "JOULEMAP_WORKERS": "0",
        },
    )
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{server.port}", timeout=60.0) as http:
            wait_until(lambda: answers(http, "/readyz"), 300.0)
            place = ask(http, hill_tif)
        yield Service(folder, server.port, f"{place}/events")
    finally:
        server.stop()


def test_who_reads_nothing_stops_nobody_else_and_is_ended(service: Service) -> None:
    with Crowd() as crowd:
        crowd.hold(service, FILE, 60)
        began = time.monotonic()
        with service.client() as same:
            wait_until(lambda: same.get("/v1").status_code == 429, 10.0)
            refused = same.get("/v1")
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.headers["retry-after"] == "5"
        problem = refused.json()
        assert problem["context"] == {"found": FEW, "limit": FEW, "retry_after_s": 5.0}
        assert f"address 127.0.0.1 has {FEW} connections" in problem["detail"]
        assert "JOULEMAP_CLIENT_CONNECTIONS" in problem["detail"]
        assert service.probes() == {200}
        assert service.status(address=OTHER) == 200
        wait_until(lambda: service.status() == 200, 10.0)
        assert time.monotonic() - began >= STALLED_S
        assert crowd.statuses() == {200: FEW, 429: 60 - FEW}


def test_who_reads_nothing_makes_room_where_all_are_answered(service: Service) -> None:
    with Crowd() as crowd:
        for last in range(2, 5):
            crowd.hold(service, FILE, FEW, f"127.0.0.{last}")
        assert service.probes() == {200}
        wait_until(lambda: service.status() == 200, STALLED_S + 5.0)


def test_a_full_service_says_so_and_answers_probes(service: Service) -> None:
    with Crowd() as crowd:
        for last in range(2, 2 + ALL // STREAMS + 1):  # streams are no stalled answers
            crowd.hold(service, service.events, STREAMS, f"127.0.0.{last}")
        with service.client() as client:
            wait_until(lambda: client.get("/v1").status_code == 503, 10.0)
            refused = client.get("/v1")
        assert refused.headers["retry-after"] == "5"
        assert refused.json()["context"] == {"found": ALL, "limit": ALL, "retry_after_s": 5.0}
        assert "JOULEMAP_MAX_CONNECTIONS" in refused.json()["detail"]
        assert service.probes() == {200}
    wait_until(lambda: service.status() == 200, 10.0)


def test_streams_of_an_address_are_few(service: Service) -> None:
    with Crowd() as crowd:
        crowd.hold(service, service.events, STREAMS + 4)
        assert crowd.statuses() == {200: STREAMS, 429: 4}
        assert service.probes() == {200}
        assert service.status() == 200
        with service.client() as client:
            refused = client.get(service.events)
        assert f"address 127.0.0.1 has {STREAMS} event streams" in refused.json()["detail"]


def test_only_a_trusted_proxy_says_whose_request_it_is(service: Service) -> None:
    with Crowd() as crowd:
        crowd.hold(service, service.events, STREAMS, PROXY, "X-Forwarded-For: 10.0.0.7\r\n")
        assert crowd.statuses() == {200: STREAMS}
        crowd.hold(service, service.events, 1, PROXY, "X-Forwarded-For: 10.0.0.7\r\n")
        assert crowd.statuses() == {429: 1}
        crowd.hold(service, service.events, 1, PROXY, "X-Forwarded-For: 10.0.0.8\r\n")
        assert crowd.statuses() == {200: 1}
        for last in range(STREAMS):
            crowd.hold(service, service.events, 1, OTHER, f"X-Forwarded-For: 10.0.1.{last}\r\n")
            assert crowd.statuses() == {200: 1}
        crowd.hold(service, service.events, 1, OTHER, "X-Forwarded-For: 10.0.1.9\r\n")
        assert crowd.statuses() == {429: 1}


@pytest.mark.parametrize("path", ["/v1/costmaps", "/v1/calibrations", "/v1/heightmaps", "/v1/runs"])
def test_a_body_of_500_000_unknown_keys_is_answered(service: Service, path: str) -> None:
    body = json.dumps(dict.fromkeys(map(str, range(500_000)), 1)).encode()
    with socket.create_connection(("127.0.0.1", service.port), timeout=30.0) as connection:
        kind = f"Content-Type: application/json\r\nContent-Length: {len(body)}"
        head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{kind}\r\n\r\n"
        connection.sendall(head.encode() + body)  # a client that reads only when all is sent
        assert connection.recv(12) == b"HTTP/1.1 413"


def test_connections_and_streams_of_a_key_are_few_from_whatever_address(service: Service) -> None:
    """The last one: from now on this service wants keys."""
    add = [sys.executable, "-m", "joulemap.service.cli", "keys", "add", "team", "--operator"]
    added = subprocess.run(
        [*add, "--data-dir", str(service.folder / "data")], check=True, capture_output=True, text=True
    )
    key = next(word for word in added.stdout.split() if word.startswith("jm_"))
    header = f"X-API-Key: {key}\r\n"
    wait_until(lambda: service.status() == 401, 10.0)
    with ExitStack() as stack:
        for last in range(2, 2 + STREAMS):
            crowd = stack.enter_context(Crowd())
            crowd.hold(service, service.events, 1, f"127.0.0.{last}", header)
            assert crowd.statuses() == {200: 1}
        with service.client("127.0.0.50", {"X-API-Key": key}) as client:
            assert f"key team has {STREAMS} event streams" in client.get(service.events).json()["detail"]
            for last in range(FEW - STREAMS):
                half = f"X-API-Key: {key}\r\nContent-Length: 9\r\n"
                stack.enter_context(Crowd()).hold(
                    service, "/v1/heightmaps", 1, f"127.0.0.{60 + last}", half, method="POST"
                )
            wait_until(lambda: client.get("/v1").status_code == 429, 10.0)
            assert f"key team has {FEW} connections" in client.get("/v1").json()["detail"]
            assert client.get("/metrics").status_code == 200
        assert service.status("/healthz") == service.status("/readyz") == 200
