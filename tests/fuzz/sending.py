"""Sends the hostile files to a service, and looks at its answers, its time, its memory and what it leaves behind."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import psutil

from joulemap.model.robot import Robot
from joulemap.service.http.app import create_app
from joulemap.service.storage.stats import heightmap_stats
from tests.fuzz.bombs import BOMBS
from tests.fuzz.files import COSTMAPS, MAKERS, PATHS, Maker, hostile_files
from tests.fuzz.reading import MEMORY_MB, SECONDS
from tests.service.conftest import hill, settings_for
from tests.service.test_contract import served


@dataclass
class Answers:
    """What the service answered to hostile files."""

    statuses: Counter[int] = field(default_factory=Counter)
    slowest: tuple[float, str] = (0.0, "")
    largest: tuple[float, str] = (0.0, "")
    failures: list[str] = field(default_factory=list)

    def table(self) -> str:
        """The figures in three lines."""
        counts = ", ".join(f"{status}: {count}" for status, count in sorted(self.statuses.items()))
        return (
            f"files: {sum(self.statuses.values())} ({counts})\nslowest: {self.slowest[0]:.2f} s, {self.slowest[1]}\n"
            f"most memory of a process: {self.largest[0]:.0f} MB, {self.largest[1]}"
        )


def send_files(count: int, seed: int, folder: Path, *, makers: Sequence[Maker] = MAKERS) -> Answers:
    """Send hostile files to a service of its own, one after the other."""
    assert set(BOMBS) < set(MAKERS)
    found = Answers()
    app = create_app(settings_for(folder, workers=0))
    with served(app) as url, httpx.Client(base_url=url, timeout=120.0) as client, _Watch() as watch:
        store = app.state.service.store
        before = _kept(folder)
        heightmap = store.add_heightmap(hill(), name="hill", stats=heightmap_stats(hill()))
        costmap = store.add_costmap(
            heightmap.id, {"robot": Robot().as_dict(), "model": "physics", "spacing_m": 1.0, "headings": 16}
        )
        client.post("/v1/runs", content=b"t,x\n1,2\n")  # the process that reads is started
        for number, sent in enumerate(hostile_files(count, seed, makers)):
            watch.peak_mb = 0.0
            start = time.monotonic()
            kind = "application/json" if sent.to in (COSTMAPS, PATHS) else "application/octet-stream"
            answer = client.post(
                sent.to.format(costmap.id), params=sent.params, content=sent.content, headers={"Content-Type": kind}
            )
            seconds, label = time.monotonic() - start, f"{sent.kind} (number {number})"
            found.statuses[answer.status_code] += 1
            found.slowest = max(found.slowest, (seconds, label))
            found.largest = max(found.largest, (watch.peak_mb, label))
            found.failures += [f"{label}: {wrong}" for wrong in _wrong(answer, seconds, watch.peak_mb)]
            if answer.status_code == 201:
                assert client.delete(answer.headers["Location"]).status_code == 204
        assert client.get("/healthz").status_code == 200
        lists = [client.get(f"/v1/{name}").status_code for name in ("heightmaps", "runs", "costmaps")]
        assert lists == [200, 200, 200]
        store.delete_costmap(costmap.id)
        store.delete_heightmap(heightmap.id)
        left = _kept(folder) - before
        found.failures += [f"left behind: {path}" for path in sorted(map(str, left))]
    return found


def _wrong(answer: httpx.Response, seconds: float, peak_mb: float) -> list[str]:
    wrong = []
    if not (200 <= answer.status_code < 300 or 400 <= answer.status_code < 500):
        wrong.append(f"status {answer.status_code}: {answer.text[:200]}")
    if answer.status_code >= 400 and not answer.json().get("detail"):
        wrong.append("no reason is given")
    if answer.status_code >= 400 and len(answer.content) > 20_000:
        wrong.append(f"a refusal of {len(answer.content)} bytes")
    if "cannot be read: " in answer.text and "Error: " in answer.text.split("cannot be read: ")[1][:40]:
        wrong.append(f"a reader was confused: {answer.text[:300]}")
    if seconds > SECONDS:
        wrong.append(f"{seconds:.1f} s")
    if peak_mb > MEMORY_MB:
        wrong.append(f"{peak_mb:.0f} MB")
    return wrong


def _kept(folder: Path) -> set[Path]:
    names = ("uploads", "heightmaps", "runs", "costmaps")
    return {path for name in names for path in (folder / name).rglob("*") if path.is_file()}


class _Watch:
    """The most memory that a process below this one took, looked at all the time."""

    def __init__(self) -> None:
        self.peak_mb = 0.0
        self._over = threading.Event()
        self._rest: dict[int, float] = {}
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> _Watch:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        me = psutil.Process()
        while not self._over.wait(0.02):
            for process in me.children(recursive=True):
                try:
                    self.peak_mb = max(self.peak_mb, process.memory_info().rss / 1e6)
                except psutil.NoSuchProcess:
                    continue
