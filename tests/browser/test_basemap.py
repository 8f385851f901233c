"""A base map that the operator set: chosen by a click, in its place on the map, allowed for its host alone."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import httpx
import numpy as np
import pytest
from PIL import Image
from pyproj import Transformer

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.browser.chromium import inaccessible, opened
from tests.browser.conftest import serving

CRS, SIDE = "EPSG:32633", 2000.0
WEST, NORTH = 287_000.0, 5_650_000.0
"""Three degrees west of the middle of its zone: the map's north is turned against that of the pictures."""


def colour_of(x: int, y: int) -> tuple[int, int, int]:
    """Neighbouring pictures differ in every part."""
    return 40 * (x % 6), 40 * (y % 6), 100


class Pictures(BaseHTTPRequestHandler):
    """Each of one colour, which says which picture it is."""

    asked: ClassVar[list[str]] = []
    referers: ClassVar[set[str | None]] = set()

    def do_GET(self) -> None:
        self.asked.append(self.path)
        self.referers.add(self.headers["Referer"])
        x, y = self.path.removesuffix(".png").split("/")[-2:]
        sink = io.BytesIO()
        Image.new("RGB", (256, 256), colour_of(int(x), int(y))).save(sink, "png")
        self.send_response(200)
        self.send_header("Content-Type", "image/png")
        self.end_headers()
        self.wfile.write(sink.getvalue())

    def log_message(self, *_: Any) -> None:
        """Quiet."""


@pytest.fixture
def pictures() -> Iterator[str]:
    """The address of a host of pictures."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Pictures)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def made(url: str) -> str:
    """A cost map of 2 km, in cells of 20 m."""
    count = int(SIDE / 20.0)
    heights = np.add.outer(np.linspace(30.0, 0.0, count), np.linspace(0.0, 10.0, count)).astype(np.float32)
    ground = Heightmap(heights, GridFrame(WEST, NORTH, 20.0, count, count, CRS))
    with httpx.Client(base_url=url, timeout=200.0) as client:
        sent = client.post("/v1/heightmaps", content=write_geotiff(None, ground)).json()
        asked = {"heightmap_id": sent["id"], "model": "physics", "spacing_m": 20.0}
        return str(client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=100"}).json()["id"])


def test_the_pictures_lie_where_they_belong(browser: Any, tmp_path: Path, pictures: str) -> None:
    whose = '© <a href="https://maps.example">Maps</a>'
    settings = {"basemap_url": f"{pictures}/tiles/{{z}}/{{x}}/{{y}}.png", "basemap_attribution": whose}
    with serving(tmp_path, **settings) as url, opened(browser, url, hash=f"#map={made(url)}") as tab:
        policy = tab.response.headers["content-security-policy"]
        assert f"img-src {pictures} 'self'" in policy
        assert policy.count("http") == 1
        for name in ("contours", "blocked", "roses"):
            tab.page.uncheck(f"#show-{name}")
        tab.page.check("text=Ground only")
        assert not Pictures.asked  # it is off until somebody wants it
        tab.page.check("text=Base map")
        tab.page.wait_for_function(
            "() => document.querySelectorAll('.leaflet-basemap-pane .leaflet-tile-loaded').length"
        )
        tab.page.wait_for_load_state("networkidle")
        tab.page.wait_for_timeout(500)  # they come into sight by and by
        assert "Maps" in tab.text(".leaflet-control-attribution")
        assert Pictures.referers == {f"{url}/"}
        assert not inaccessible(tab.page)
        zooms = {int(path.split("/")[2]) for path in Pictures.asked}
        assert len(zooms) == 1
        seen = Image.open(io.BytesIO(tab.page.screenshot())).convert("RGB")
        on_earth, count, found = Transformer.from_crs(CRS, "EPSG:4326"), 2 ** zooms.pop(), set()
        for x, y in np.random.default_rng(0).uniform(100.0, SIDE - 100.0, (60, 2)):
            lat, lon = on_earth.transform(WEST + x, NORTH - y)
            across, down = count * (lon / 360 + 0.5), count * (0.5 - np.arcsinh(np.tan(np.deg2rad(lat))) / (2 * np.pi))
            if min(across % 1, 1 - across % 1, down % 1, 1 - down % 1) > 0.02:  # not between two pictures
                wanted = colour_of(int(across), int(down))
                at = tab.place(WEST + x, NORTH - y)
                assert np.allclose(seen.getpixel((int(at[0]), int(at[1]))), wanted, atol=2), (x, y)
                found.add(wanted)
        assert len(found) > 8
        tab.page.uncheck("text=Base map")
        assert tab.page.locator(".leaflet-basemap-pane canvas").count() == 0
        assert "Maps" not in tab.text(".leaflet-control-attribution")
