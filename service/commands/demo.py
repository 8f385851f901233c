"""`joulemap demo`: start the service, ask it everything over HTTP, say the answers in plain words, draw the picture."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import typer
from rich.console import Console
from scipy import ndimage

from joulemap.model.errors import HeightmapError, JoulemapError
from joulemap.model.terrain.synthesis import SAMPLE_GOAL, SAMPLE_START, sample_terrain
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.route import price_route
from joulemap.service.client import Client
from joulemap.service.commands.answers import say_feasibility, say_map, say_path, served_map
from joulemap.service.commands.console import Output, write_file
from joulemap.service.commands.options import Reading
from joulemap.service.commands.remote import unpack
from joulemap.service.library.heightmaps import read_heightmap
from joulemap.service.places.places import Places
from joulemap.service.render.pictures import route_picture
from joulemap.service.schemas.maps import HeightmapOut

READY_WITHIN_S = 600.0
COSTMAP_WITHIN_S = 300
CHARGE, RESERVE = 0.5, 0.2  # the battery that the demo asks about: half full, a fifth kept back

_EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1"}  # listening at every address includes this one

Point = tuple[float, float]


def run_demo(
    output: Output,
    *,
    heightmap: Path | None,
    start: Point | None,
    goal: Point | None,
    model: str,
    host: str,
    port: int,
    out: Path,
    keep: bool,
    reading: Reading,
) -> None:
    """Run the demo. Raises JoulemapError in the service's words."""
    if (start is None) != (goal is None):
        raise typer.BadParameter("give both --start and --goal, or neither")
    ground = sample_terrain() if heightmap is None else read_heightmap(heightmap, **reading)
    places = Places(ground.frame)
    task = None if heightmap else (SAMPLE_START, SAMPLE_GOAL)
    if start is not None and goal is not None:
        task = places(start, "start"), places(goal, "goal")
    name = "joulemap sample" if heightmap is None else heightmap.name
    picture = out / "joulemap-demo.png"
    with _service(host, port, out) as (process, url):
        output.say(f"is running at {url}", head="joulemap")
        with Client(url, timeout_s=COSTMAP_WITHIN_S + 60.0) as client:
            sent = client.heightmap(heightmap or ground, name=name, **({} if heightmap is None else reading))
            _say_heightmap(output, sent)
            costs = client.costmap(sent, model=model, timeout_s=COSTMAP_WITHIN_S)
            robot = costs.about.robot
            unpack(costs.data("zarr"), out / "costmap.zarr")
            output.say(f"for {robot.name}, model {model}", head="\nCost map")
            say_map(output, served_map(costs, out / "costmap.zarr"))
            lattice = load_lattice(out / "costmap.zarr")
            ends = task or free_corners(lattice)
            path = costs.plan(*ends)
            output.say()
            say_path(output, path.model_dump(mode="json"), robot.name)
            verdict = costs.feasibility(start=ends[0], goal=ends[1], round_trip=True, charge=CHARGE, reserve=RESERVE)
            battery = f"{robot.battery_wh:g} Wh at {CHARGE:.0%}, keeping {RESERVE:.0%}, there and back"
            output.say(battery, head="\nBattery")
            say_feasibility(output, verdict.model_dump(mode="json"))
        best, shortest = (
            price_route(lattice, np.array(found.path, dtype=np.float64)[:, :2]) for found in (path, path.shortest)
        )
        title = f"{name}: energy-optimal and shortest path"
        write_file(picture, route_picture(ground, best, shortest, title=title))
        output.say(f"{picture}", head="\nPicture")
        answers: dict[str, Any] = {"heightmap": sent, "costmap": costs.about, "path": path, "feasibility": verdict}
        document = {key: answer.model_dump(mode="json") for key, answer in answers.items()}
        output.document(
            {"url": url, "picture": str(picture), **document, "start": list(ends[0]), "goal": list(ends[1])}
        )
        if keep:
            places_in_link = "&".join(
                f"{key}={x:.2f},{y:.2f}" for key, (x, y) in zip(("from", "to"), ends, strict=True)
            )
            page = f"{url}/#map={costs.id}&{places_in_link}&battery={CHARGE},{RESERVE}&back=1"
            output.say(
                f"{page}\nThis map and route, to look at and to change; your own "
                f"ground: {url}\nThe service goes on until you press Ctrl-C.",
                head="\nPage",
            )
            with contextlib.suppress(KeyboardInterrupt):
                process.wait()


def _say_heightmap(output: Output, sent: HeightmapOut) -> None:
    cell = sent.resolution_m
    unknown = f", {1.0 - sent.known_share:.1%} of it unknown" if sent.known_share < 1.0 else ""
    output.say(
        f"{sent.name}: {sent.cols * cell:g} x {sent.rows * cell:g} m "
        f"in cells of {cell:g} m, {sent.height_min_m:.1f} to {sent.height_max_m:.1f} m high{unknown}",
        head="\nHeightmap",
    )


def free_corners(lattice: CostLattice) -> tuple[Point, Point]:
    """Return two places near opposite corners, south-west and north-east, that a route surely joins.

    They lie in the largest piece of ground whose cells may be driven in every heading.

    Raises HeightmapError if there is no such ground.
    """
    free = (lattice.blocked_by_heading() == Blocked.FREE).all(axis=2)
    pieces, count = ndimage.label(free)
    if count == 0:
        raise HeightmapError("no cell of this map can be driven in every direction: give --start and --goal")
    cells = np.argwhere(pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:]))
    east, south = cells[:, 1], cells[:, 0]
    ends = cells[np.argmin(east - south)], cells[np.argmax(east - south)]
    (x0, y0), (x1, y1) = (lattice.frame.xy(*cell) for cell in ends)
    return (float(x0), float(y0)), (float(x1), float(y1))


@contextlib.contextmanager
def _service(host: str, port: int, out: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A service of our own on `port` or, where that is taken, a free one; ready when given, ended afterwards."""
    out.mkdir(parents=True, exist_ok=True)
    port = _free_port(host, port)
    url = f"http://{_EVERY_ADDRESS.get(host, host)}:{port}"
    log = out / "service.log"
    options = {"--host": host, "--port": str(port), "--data-dir": str(out / f"data-{port}")}
    command = [
        sys.executable,
        "-m",
        "joulemap.service.cli",
        "serve",
        *(word for pair in options.items() for word in pair),
    ]
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that `finally` runs and no service is left
    try:
        with log.open("wb") as sink:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, start_new_session=True
            )
        try:
            _await_ready(process, url, log)
            yield process, url
        finally:
            process.terminate()
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    finally:
        signal.signal(signal.SIGTERM, before)


def _await_ready(process: subprocess.Popen[bytes], url: str, log: Path) -> None:
    deadline = time.monotonic() + READY_WITHIN_S
    words = "Starting the service (the first time, its kernels are compiled)"
    with Console(stderr=True).status(words), httpx.Client(base_url=url, timeout=5.0) as client:
        while time.monotonic() < deadline:
            if process.poll() is not None:
                raise JoulemapError(f"the service ended with {process.returncode}: {_last_words(log)} (more in {log})")
            with contextlib.suppress(httpx.TransportError):
                answer = client.get("/readyz")
                if answer.is_success:
                    return
                if "failed" in answer.json()["detail"]:
                    raise JoulemapError(f"the service cannot get ready: {_last_words(log)} (more in {log})")
            time.sleep(0.2)
    raise JoulemapError(f"the service is not ready after {READY_WITHIN_S:.0f} s: see {log}")


def _last_words(log: Path) -> str:
    """The last error in a log, or its last line."""
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return next((line for line in reversed(lines) if "Error" in line), lines[-1] if lines else "nothing")


def _free_port(host: str, wanted: int) -> int:
    """`wanted`, or one that the system picks where that is 0 or taken."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise JoulemapError(f"a service cannot listen at {host}: it is no address of this machine, or has no free port")
