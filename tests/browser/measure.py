"""How quick the page is: ready on loopback, drop to drawn on a large map, frames while panning, size of its files.

python -m tests.browser.measure
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from scipy import ndimage

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.browser.chromium import launched, opened
from tests.browser.conftest import serving

SIDE, DRAGS, LOADS, PAN_S = 1000, 50, 10, 4.0
WEB = Path(__file__).resolve().parents[2] / "service" / "web"
_FRAMES = """() => new Promise(done => {
  const began = performance.now(), times = [];
  const frame = now => { times.push(now); if (now - began < %d) requestAnimationFrame(frame); else done(times); };
  requestAnimationFrame(frame);
})"""
_DROPPED = """() => {
  window.dropped = new Promise(done => {
    window.addEventListener("pointerup", () => {
      const at = performance.now(), seen = [];
      for (const name of ["drawn-rough", "drawn"]) document.addEventListener(name, () => requestAnimationFrame(() => {
        seen.push(performance.now() - at);
        if (name === "drawn") done([seen[0], seen.at(-1)]);
      }), { once: true });
    }, { once: true, capture: true });
  });
}"""


def ground() -> Heightmap:
    """Hills of up to some degrees, 1000 x 1000 m."""
    rng = np.random.default_rng(0)
    heights = sum(
        height * ndimage.gaussian_filter(rng.standard_normal((SIDE, SIDE)), sigma) * sigma
        for sigma, height in ((60.0, 12.0), (12.0, 1.0))
    )
    return Heightmap(np.asarray(heights, dtype=np.float32), GridFrame(0.0, float(SIDE), 1.0, SIDE, SIDE))


def made(client: httpx.Client, model: str) -> str:
    """The id of a cost map of the hills."""
    sent = client.post("/v1/heightmaps", content=write_geotiff(None, ground()), params={"name": "hills"}).json()
    wish = {"heightmap_id": sent["id"], "model": model}
    found = client.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}).json()
    assert found["status"] == "done", found
    return str(found["id"])


def ready(browser: Any, url: str) -> list[float]:
    """Seconds until the page can be used, of several loads."""
    found = []
    for _ in range(LOADS):
        with opened(browser, url) as tab:
            found.append(tab.page.evaluate("document.documentElement.dataset.readyAt / 1000"))
    return [float(value) for value in found]


def dragged(tab: Any) -> np.ndarray:
    """Milliseconds from the drop of the goal until its routes are drawn, and until they are improved: (drags, 2)."""
    rng, found = np.random.default_rng(1), []
    for _ in range(DRAGS):
        x, y = rng.uniform(0.05 * SIDE, 0.95 * SIDE, 2)
        tab.page.evaluate(_DROPPED)
        tab.drag(".pin.goal", float(x), float(y))
        found.append(tab.page.evaluate("() => window.dropped"))
    return np.array(found)


def frames(tab: Any) -> list[float]:
    """Milliseconds between frames while the map is moved with the mouse."""
    times = tab.page.evaluate_handle(f"() => {{ window.frames_seen = ({_FRAMES % int(1000 * PAN_S)})(); }}")
    box = tab.page.locator("#map").bounding_box()
    x, y = box["x"] + 0.3 * box["width"], box["y"] + 0.2 * box["height"]
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    began, k = time.monotonic(), 0
    while time.monotonic() - began < PAN_S:
        k += 1
        tab.page.mouse.move(x + 120.0 * np.sin(k / 9.0), y + 60.0 * np.cos(k / 7.0))
    tab.page.mouse.up()
    del times
    seen = np.array(tab.page.evaluate("() => window.frames_seen"))
    return [float(value) for value in np.diff(seen)]


def main() -> None:
    """Measure, and print a table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder), workers=1) as url,
        launched() as browser,
        httpx.Client(base_url=url, timeout=400.0) as client,
    ):
        while client.get("/readyz").status_code != 200:
            time.sleep(0.2)
        loads = ready(browser, url)
        rows = [("page ready on loopback", f"{np.median(loads):.2f} s", f"{max(loads):.2f} s at most of {LOADS}")]
        for model in ("physics", "default"):
            with opened(browser, url, hash=f"#map={made(client, model)}&from=100,100&to=900,900") as tab:
                tab.drawn()
                tab.page.wait_for_timeout(8000)
                for name, drags in zip(("routes drawn", "routes improved"), dragged(tab).T, strict=True):
                    q50, q95 = np.quantile(drags, [0.5, 0.95])
                    note = f"95 % of {DRAGS} drops; median {q50:.0f} ms"
                    rows.append((f"{name}, {model}", f"{q95:.0f} ms", note))
                between = frames(tab)
                rate, slow = 1000.0 / np.mean(between), np.quantile(between, 0.95)
                rows.append((f"panning, {model}", f"{rate:.0f} frames/s", f"95 % of frames within {slow:.0f} ms"))
    size = sum(file.stat().st_size for file in WEB.iterdir() if file.suffix in (".js", ".css"))
    rows.append(("own scripts and styles", f"{size / 1000:.0f} kB", ""))
    print(f"{SIDE} x {SIDE} cells; {platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name, value, note in rows:
        print(f"{name:32} {value:>14}  {note}")


if __name__ == "__main__":
    main()
