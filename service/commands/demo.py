"""`joulemap demo`: start the service, ask it everything over HTTP, say the answers in plain words, draw the picture."""

from __future__ import annotations

import contextlib
import io
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from rich.console import Console
from scipy import ndimage

from joulemap.model.errors import HeightmapError, InputError, JoulemapError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import read_heightmap
from joulemap.model.terrain.synthesis import SAMPLE_GOAL, SAMPLE_START, sample_terrain
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.answers import Plan
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.io import load_lattice
from joulemap.planner.route import price_route
from joulemap.service.commands.console import Output, write_file
from joulemap.service.commands.options import Reading
from joulemap.service.pictures import route_picture
from joulemap.service.places import Places
from joulemap.service.words import energy_words, route_words, saving_words

READY_WITHIN_S = 180.0
COSTMAP_WITHIN_S = 300
CHARGE, RESERVE = 0.5, 0.2  # the battery that the demo asks about: half full, a fifth kept back

_EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1"}  # listening at every address includes this one

Point = tuple[float, float]


@dataclass(frozen=True)
class Ground:
    """A heightmap as it is sent, and the task on it.

    Attributes
    ----------
    name : str
        Of the file.
    content : bytes
        Of the file.
    heightmap : Heightmap
        The same as a value.
    start, goal : tuple of float, optional
        World x, y [m]. Without them they are chosen.
    reading : mapping
        What the file does not say, as query parameters of the service.
    """

    name: str
    content: bytes
    heightmap: Heightmap
    start: Point | None
    goal: Point | None
    reading: Mapping[str, str]


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
    """Run the demo.

    Parameters
    ----------
    output : Output
        Where the answers are said.
    heightmap : Path, optional
        Another heightmap than the sample.
    start, goal : tuple of float, optional
        World x, y [m]; both or neither.
    model : str
        A model that the service has.
    host, port : str, int
        Where the service listens; another port where this one is in use.
    out : Path
        Folder for the picture and the service's data.
    keep : bool
        Let the service run until the user stops it.
    reading : Reading
        What the heightmap's file does not say.

    Raises
    ------
    JoulemapError
        In the service's words.
    """
    if (start is None) != (goal is None):
        raise InputError("give both --start and --goal, or neither")
    ground = _ground(heightmap, start, goal, reading)
    picture = out / "joulemap-demo.png"
    with _service(host, port, out) as (process, url):
        output.say(f"is running at {url}", head="joulemap")
        with httpx.Client(base_url=url, timeout=COSTMAP_WITHIN_S + 60.0) as client:
            answers = _ask(output, client, ground, model, out)
        title = f"{ground.name}: energy-optimal and shortest path"
        write_file(picture, route_picture(ground.heightmap, answers.plan.route, answers.plan.shortest, title=title))
        output.say(f"{picture}", head="\nPicture   ")
        output.warn(answers.document["costmap"]["warnings"])
        output.document({"url": url, "picture": str(picture), **answers.document})
        if keep:
            page = f"{url}/#map={answers.document['costmap']['id']}&{_ends_in_link(answers.document)}"
            output.say(
                f"{page}\n           This map and route, to look at and to change; your own "
                f"ground: {url}\nThe service goes on until you press Ctrl-C.",
                head="\nPage      ",
            )
            with contextlib.suppress(KeyboardInterrupt):
                process.wait()


@dataclass(frozen=True)
class _Answers:
    plan: Plan
    document: dict[str, Any]


def _ask(output: Output, client: httpx.Client, ground: Ground, model: str, out: Path) -> _Answers:
    """Heightmap, cost map, path and verdict over HTTP, each said in words as soon as it is there."""
    sent = _json(client.post("/v1/heightmaps", params={"name": ground.name, **ground.reading}, content=ground.content))
    cell = sent["resolution_m"]
    unknown = f", {1.0 - sent['known_share']:.1%} of it unknown" if sent["known_share"] < 1.0 else ""
    output.say(
        f"{sent['name']}: {sent['cols'] * cell:g} x {sent['rows'] * cell:g} m "
        f"in cells of {cell:g} m, {sent['height_min_m']:.1f} to {sent['height_max_m']:.1f} m high{unknown}",
        head="\nHeightmap ",
    )

    began = time.perf_counter()
    wish = {"heightmap_id": sent["id"], "model": model}
    costmap = _json(client.post("/v1/costmaps", json=wish, headers={"Prefer": f"wait={COSTMAP_WITHIN_S}"}))
    if costmap["status"] != "done":
        raise JoulemapError(f"the cost map is not done after {COSTMAP_WITHIN_S} s, but {costmap['status']}")
    seconds = time.perf_counter() - began
    frame, price, blocked = costmap["frame"], costmap["energy_per_m"], costmap["blocked"]
    size = f"{frame['cols']} x {frame['rows']} cells of {frame['spacing_m']:g} m, {costmap['headings']} headings"
    reasons = [f"{share:.1%} {reason.replace('_', ' ')}" for reason, share in blocked.items() if share > 0]
    output.say(
        f"{size}, made in {seconds:.1f} s"
        f" by model {model}; driving costs {price['min']:.0f} to {price['max']:.0f} J/m, {price['mean']:.0f} on average"
        f"\n           ({', '.join(reasons)})"
        if price
        else "nothing of this ground can be driven",
        head="Cost map  ",
    )

    lattice = _download(client, costmap["id"], out / "costmap.zarr")
    start, goal = ground.start, ground.goal
    if start is None or goal is None:
        start, goal = free_corners(lattice)
    ends = {"start": list(start), "goal": list(goal)}
    path = _json(client.post(f"/v1/costmaps/{costmap['id']}/paths", json=ends))
    output.say(
        f"from ({start[0]:.2f}, {start[1]:.2f}) to ({goal[0]:.2f}, {goal[1]:.2f})\n"
        f"           energy-optimal  {route_words(path)}\n"
        f"           shortest        {route_words(path['shortest'])}",
        head="Path      ",
    )
    output.say(head=f"           saved           {saving_words(path, path['shortest'])}")

    battery = {"charge": CHARGE, "reserve": RESERVE}
    task = {**ends, "round_trip": True, "battery": battery}
    verdict = _json(client.post(f"/v1/costmaps/{costmap['id']}/feasibility", json=task))
    capacity_wh = lattice.robot.battery_wh
    mark = "yes" if verdict["feasible"] else "no"
    left = (
        f"{verdict['charge_at_end']:.1%} charge left at the end, {energy_words(verdict['margin_j'])} above the reserve"
        if verdict["feasible"]
        else f"{energy_words(verdict['shortfall_j'])} are missing"
    )
    output.say(
        f"there and back on a {capacity_wh:g} Wh battery at {CHARGE:.0%}, keeping {RESERVE:.0%}? "
        f"{mark}\n           {energy_words(verdict['energy_j'])} over {verdict['length_m']:.0f} m; {left}",
        head="Battery   ",
    )

    def priced(points: list[list[float]]) -> Any:
        return price_route(lattice, np.array(points, dtype=np.float64)[:, :2])

    plan = Plan(priced(path["path"]), priced(path["shortest"]["path"]), path["planner"], path["details"])
    document = {"heightmap": sent, "costmap": costmap, "path": path, "feasibility": verdict, **ends}
    return _Answers(plan, document)


def _ends_in_link(document: Mapping[str, Any]) -> str:
    """Start, goal and battery as in the address of the page."""
    start, goal = (",".join(f"{value:.2f}" for value in document[end]) for end in ("start", "goal"))
    return f"from={start}&to={goal}&battery={CHARGE},{RESERVE}&back=1"


def free_corners(lattice: CostLattice) -> tuple[Point, Point]:
    """Return two places near opposite corners, south-west and north-east, that a route surely joins.

    They lie in the largest piece of ground whose cells may be driven in every heading.

    Parameters
    ----------
    lattice : CostLattice
        Of the map.

    Returns
    -------
    tuple of tuple of float
        Start and goal, world x, y [m].

    Raises
    ------
    HeightmapError
        If there is no such ground.
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


def _ground(file: Path | None, start: Point | None, goal: Point | None, reading: Reading) -> Ground:
    if file is not None:
        known = read_heightmap(file, **reading)
        places = Places(known.frame)
        start, goal = (place and places(place, name) for place, name in ((start, "start"), (goal, "goal")))
        given = {key: str(value) for key, value in reading.items() if value is not None}
        return Ground(file.name, file.read_bytes(), known, start, goal, given)
    sample = sample_terrain()
    content = write_geotiff(None, sample)
    assert content is not None
    return Ground("joulemap sample", content, sample, start or SAMPLE_START, goal or SAMPLE_GOAL, {})


@contextlib.contextmanager
def _service(host: str, port: int, out: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A service of our own on `port` or, where that is taken, a free one; ready when given, ended afterwards."""
    out.mkdir(parents=True, exist_ok=True)
    port = _free_port(host, port)
    url = f"http://{_EVERY_ADDRESS.get(host, host)}:{port}"
    log = out / "service.log"
    command = [
        sys.executable,
        "-m",
        "joulemap.service.cli",
        "serve",
        "--host",
        host,
        "--port",
        str(port),
        "--data-dir",
        str(out / f"data-{port}"),
    ]
    before = signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(143)
    )  # so that `finally` runs and no service is left over
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


def _download(client: httpx.Client, costmap_id: str, folder: Path) -> CostLattice:
    """The cost map as zarr, unpacked into `folder`."""
    answer = client.get(f"/v1/costmaps/{costmap_id}/data", params={"format": "zarr"})
    if answer.is_error:
        _json(answer)
    with zipfile.ZipFile(io.BytesIO(answer.content)) as packed, tempfile.TemporaryDirectory(dir=folder.parent) as place:
        packed.extractall(place)
        shutil.rmtree(folder, ignore_errors=True)
        next(Path(place).iterdir()).rename(folder)
    return load_lattice(folder)


def _json(response: httpx.Response) -> dict[str, Any]:
    """The body of a good answer. Raises InputError or JoulemapError with the words of a problem."""
    body: dict[str, Any] = response.json()
    if response.is_error:
        kind = InputError if response.status_code < 500 else JoulemapError
        raise kind(f"the service answered {response.status_code}: {body.get('detail', body)}")
    return body
