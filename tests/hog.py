"""`python -m tests.load --hog 64`: small questions of one key, alone and while clients of another key ask the dearest.

The clients of the other key send tours, first questions home, energy fields, routes and large heightmaps, one after
another. Everything is asked over the same address. Quiet and loud times take turns, so that other work on the machine
is in both.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from joulemap.model.terrain.writers import write_geotiff
from tests.bench.maps import terrain
from tests.load import Connection, Seen, Server, until_ready

_SMALL_CELLS, _STOPS, _ROUNDS = 100, 12, 3
_RAW = "Content-Type: application/octet-stream\r\n"
_BATTERY = {"charge": 0.6, "reserve": 0.2}
Ask = Callable[[], Awaitable[int]]


class Owner:
    """One key, with a cost map of its own."""

    def __init__(self, port: int, folder: Path, name: str) -> None:
        command = [sys.executable, "-m", "joulemap.service.cli", "keys", "add", name, "--json", "-"]
        made = subprocess.run(
            [*command, "--data-dir", str(folder / "data")], capture_output=True, text=True, check=True
        )
        self._port, self._head = port, f"Authorization: Bearer {json.loads(made.stdout)['key']}\r\n"
        self._place, self._cells = "", 0

    async def makes(self, cells: int) -> None:
        """Have a cost map of so many cells along a side."""
        ask = self.asker()
        sent = (await ask("POST", "/v1/heightmaps", _heightmap(cells), _RAW))[1]
        wanted = {"heightmap_id": json.loads(sent)["id"], "model": "physics"}
        status, made = await ask("POST", "/v1/costmaps", json.dumps(wanted).encode(), "Prefer: wait=300\r\n")
        assert status == 201, made[:500]
        self._place, self._cells = f"/v1/costmaps/{json.loads(made)['id']}", cells

    def asker(self) -> Callable[..., Awaitable[tuple[int, bytes]]]:
        """A connection of its own, which sends the key."""
        connection = Connection(self._port)

        async def _ask(method: str, path: str, body: bytes = b"", headers: str = "") -> tuple[int, bytes]:
            return await connection.ask(method, path, body, headers + self._head)

        return _ask

    def post(self, ask: Callable[..., Awaitable[tuple[int, bytes]]], question: str, **body: Any) -> Awaitable[Any]:
        """Ask about the cost map."""
        return ask("POST", f"{self._place}/{question}", json.dumps(body).encode())

    def dear(self, seen: Seen, chance: random.Random) -> Ask:
        """One client that asks one dear question after another."""
        ask, upload = self.asker(), _heightmap(self._cells)

        def _place() -> list[float]:
            return [round(chance.uniform(1.0, self._cells - 1.0), 2) for _ in range(2)]

        async def _one() -> int:
            match chance.randrange(5):
                case 0:
                    found = await self.post(ask, "tours", stops=[_place() for _ in range(_STOPS)], snap=True)
                case 1:
                    found = await self.post(ask, "return", position=_place(), home=_place(), battery=_BATTERY)
                case 2:
                    x, y = _place()
                    found = await ask("GET", f"{self._place}/field?goal_x={x}&goal_y={y}&snap=true&format=geotiff")
                case 3:
                    found = await self.post(ask, "paths", start=_place(), goal=_place(), snap=True)
                case _:
                    found = await ask("POST", "/v1/heightmaps", upload, _RAW)
            if found[0] in (503, 429):
                await asyncio.sleep(0.2)  # sooner than the service says
            return seen.saw(*found)

        return _one

    async def small(self, seen: dict[str, Seen]) -> list[Ask]:
        """Clients that ask small questions: verdicts of a given path, of the way home, and prices at a place."""
        ends = {"start": [10.0, 10.0], "goal": [90.0, 80.0], "snap": True}
        status, answer = await self.post(self.asker(), "paths", **ends)
        assert status == 200, answer[:500]
        path = [point[:2] for point in json.loads(answer)["path"]]
        home = {"position": path[3], "home": path[0], "path": path[4:], "battery": _BATTERY}
        status, answer = await self.post(self.asker(), "return", **home)  # from now on its energies are kept
        assert status == 200, answer[:500]

        def _client(name: str, question: Callable[[Any], Awaitable[Any]]) -> Ask:
            ask = self.asker()

            async def _one() -> int:
                return seen[name].saw(*await question(ask))

            return _one

        return [
            _client("verdict", lambda ask: self.post(ask, "feasibility", path=path, battery=_BATTERY)),
            _client("return", lambda ask: self.post(ask, "return", **home)),
            _client("at", lambda ask: ask("GET", f"{self._place}/at?x={path[2][0]}&y={path[2][1]}")),
        ]


def _heightmap(cells: int) -> bytes:
    data = write_geotiff(None, terrain(cells, 1.0))
    assert data is not None
    return data


async def _repeat(seen: Seen, ask: Ask, until: float, pause_s: float) -> None:
    while time.perf_counter() < until:
        began = time.perf_counter()
        status = await ask()
        seen.statuses[status] += 1
        seen.seconds.append(time.perf_counter() - began)
        await asyncio.sleep(pause_s)


async def _measured(server: Server, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    await until_ready(server, Connection(server.port))
    owner, hog = (Owner(server.port, folder, name) for name in ("owner", "hog"))
    await asyncio.sleep(3.0)  # longer than new keys take to be known
    await owner.makes(_SMALL_CELLS)
    await hog.makes(options.cells)
    names = ("verdict", "return", "at")
    quiet, loud = ({name: Seen(name) for name in names} for _ in range(2))
    dear, chance = Seen("the other key's"), random.Random(options.seed)
    part_s = options.seconds / (2 * _ROUNDS)
    for _ in range(_ROUNDS):
        for seen, clients in ((quiet, 0), (loud, options.hog)):
            small = await owner.small(seen)
            busy = [asyncio.create_task(_repeat(dear, hog.dear(dear, chance), 1e18, 0.0)) for _ in range(clients)]
            await asyncio.sleep(2.0 if busy else 0.5)
            until = time.perf_counter() + part_s
            await asyncio.gather(*(_repeat(seen[n], ask, until, 0.02) for n, ask in zip(names, small, strict=True)))
            for task in busy:
                task.cancel()
            await asyncio.gather(*busy, return_exceptions=True)
            await asyncio.sleep(2.0 if busy else 0.0)  # until what was begun has ended
    return {
        "quiet": [one.summary(options.seconds / 2) for one in quiet.values()],
        "loud": [one.summary(options.seconds / 2) for one in loud.values()],
        "dear": dear.summary(options.seconds / 2),
    }


def measure(folder: Path, options: argparse.Namespace, settings: dict[str, str]) -> dict[str, Any]:
    """Ask, and print how much longer small questions take while another key is busy."""
    server = Server(folder, settings)
    try:
        found = asyncio.run(_measured(server, folder, options))
    finally:
        server.stop()
    for before, now in zip(found["quiet"], found["loud"], strict=True):
        print(
            f"{now['question']:8} quiet p50 {before['p50_ms']:6.1f} p99 {before['p99_ms']:6.1f} ms, beside "
            f"{options.hog} clients of another key p50 {now['p50_ms']:6.1f} p99 {now['p99_ms']:6.1f} ms: "
            f"p99 {now['p99_ms'] / before['p99_ms']:.1f} times as long; {now['answers']} answers {now['statuses']}"
        )
        for count, words in ((count, words) for words, count in now["refusals"].items()):
            print(f"  {count} times: {words}")
    one = found["dear"]
    print(f"{one['question']} dear questions: {one['answers']} answers, p50 {one['p50_ms']:.0f} ms, {one['statuses']}")
    return found
