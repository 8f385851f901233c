"""`python -m tests.bench --return`: a robot on its way asks a service over HTTP until where it still comes home."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.table import Table

from tests.load import Connection, Server, _cost_map, until_ready

CELLS = 1000
QUESTIONS = 100


def compare_return() -> Table:
    """Milliseconds of questions along a route of a map of 1000 x 1000 cells, as the robot sees them."""
    with tempfile.TemporaryDirectory() as folder:
        server = Server(Path(folder), {"JOULEMAP_LOG_FORMAT": "json"})
        try:
            return asyncio.run(_asked(server))
        finally:
            server.stop()


async def _asked(server: Server) -> Table:
    robot = Connection(server.port)
    await until_ready(server, robot)
    costmap, _ = await _cost_map(robot, CELLS)
    place = f"/v1/costmaps/{costmap}"
    ends = {"start": [50.0, 50.0], "goal": [950.0, 900.0], "snap": True}
    status, answer = await robot.ask("POST", f"{place}/paths", json.dumps(ends).encode())
    assert status == 200, answer[:500]
    profile = json.loads(answer)["profile"]
    corners = [point[:2] for point in json.loads(answer)["path"]]
    table = Table(title=f"POST .../return on {CELLS} x {CELLS} cells, {QUESTIONS} questions along a route, over HTTP")
    for name in ("question", "points sent", "first [ms]", "p50 [ms]", "p95 [ms]", "most [ms]", "server, each [ms]"):
        table.add_column(name, justify="left" if name == "question" else "right")
    charging = [corners[len(corners) // 2]]
    metres = [[piece["x"], piece["y"]] for piece in profile]
    for words, way, more in (
        ("the corners of the path", corners, {}),
        ("a point every metre, 1 place to charge", metres, {"charging": charging}),
    ):
        seconds, sent, before = [], len(way), 0.0
        for k in range(QUESTIONS + 1):
            rest = way[(max(k - 1, 0) * (len(way) - 1)) // QUESTIONS :]
            asked = {"position": rest[0], "home": corners[0], "path": rest, "battery": {"charge": 0.4}, **more}
            body = json.dumps(asked).encode()
            before = server.cpu_s() if k <= 1 else before
            began = time.perf_counter()
            status, answer = await robot.ask("POST", f"{place}/return", body)
            seconds.append(time.perf_counter() - began)
            assert status == 200, answer[:500]
        used = (server.cpu_s() - before) / QUESTIONS  # without the first
        first, *later = 1e3 * np.array(seconds)
        shown = [first, *np.percentile(later, [50, 95]), max(later), 1e3 * used]
        table.add_row(words, str(sent), *(f"{value:.1f}" for value in shown))
    return table
