"""The page in a browser: from nothing to a route, by mouse, keyboard and link; errors in words; accessible."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from tests.browser.chromium import PHONE, opened
from tests.service.conftest import hill

WEB = Path(__file__).resolve().parents[2] / "service" / "web"
SAMPLE_ENDS = [[22, 96], [178, 104]]


@pytest.fixture(scope="module")
def sample(browser: Any, address: str) -> str:
    """The link to the sample with its route, as somebody gets it who clicks on the sample and does nothing else."""
    with opened(browser, address) as tab:
        tab.page.click("#sample")
        tab.drawn()
        assert "the battery lasts" in tab.text("#answer").lower()
        assert re.search(r"saves [\d.,]+ kJ \(\d", tab.text("#answer"))
        tab.page.wait_for_function("() => location.hash.includes('to=')")
        return tab.page.evaluate("location.hash")


def ends(tab: Any) -> list[Any]:
    found: list[Any] = tab.page.evaluate("[joulemap.now.start, joulemap.now.goal]")
    return found


def energy(tab: Any) -> float:
    found: float = tab.page.evaluate("joulemap.now.answer.energy_j")
    return found


def test_a_link_opens_the_same_view_again(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        assert ends(tab) == SAMPLE_ENDS
        assert tab.page.get_attribute("#tab-route", "aria-selected") == "true"


def test_the_answer_follows_a_goal_that_is_dragged(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        before = energy(tab)
        tab.drag(".pin.goal", 60.0, 150.0)
        tab.page.wait_for_function("before => joulemap.now.answer.energy_j !== before", arg=before)
        assert ends(tab)[1] == pytest.approx([60.0, 150.0], abs=2.0)
        assert energy(tab) < before  # it is nearer


def test_the_markers_and_the_profile_by_keyboard(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.page.focus(".pin.start")
        tab.page.keyboard.press("ArrowUp")
        tab.page.wait_for_function("() => joulemap.now.start[1] === 97")
        tab.page.wait_for_function("() => joulemap.now.answer?.path?.[0][1] === 97")
        tab.page.focus("#profile svg")
        tab.page.keyboard.press("End")
        length = tab.page.evaluate("joulemap.now.answer.length_m")
        assert float(tab.page.get_attribute("#profile svg", "aria-valuenow")) == pytest.approx(length, abs=1.0)
        assert "battery" in tab.page.get_attribute("#profile svg", "aria-valuetext")


def test_clicks_on_a_map_that_is_kept(browser: Any, address: str, sample: str) -> None:
    """From the list of what is kept to a route, by two clicks on the map."""
    with opened(browser, address) as tab:
        tab.page.click("#welcome li button")
        tab.page.wait_for_selector(".leaflet-image-layer.ground")
        assert "starts" in tab.text("#hint")
        tab.page.mouse.click(*tab.place(30.0, 30.0))
        tab.page.wait_for_selector(".pin.start")
        tab.page.mouse.click(*tab.place(60.0, 40.0))
        tab.page.click("#tab-route")
        tab.drawn()
        assert ends(tab) == [pytest.approx([30.0, 30.0], abs=1.0), pytest.approx([60.0, 40.0], abs=1.0)]


def test_blocked_ground_says_why(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.page.mouse.move(*tab.place(40.0, 84.0))
        tab.page.wait_for_function("() => document.getElementById('readout').textContent.includes('height unknown')")
        tab.page.fill("#place-goal", "40, 84")
        tab.page.press("#place-goal", "Enter")
        tab.page.wait_for_selector("#answer .error")
        assert "blocked ground" in tab.text("#answer .error")


def test_a_heightmap_that_cannot_be_read_and_one_that_lacks_its_scale(
    browser: Any, address: str, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.tif"
    broken.write_bytes(b"no heightmap")
    picture = tmp_path / "grey.png"
    Image.fromarray((np.random.default_rng(0).random((40, 40)) * 255).astype(np.uint8)).save(picture)
    with opened(browser, address) as tab:
        tab.page.set_input_files("#heightmap-file", broken)
        tab.page.wait_for_selector("#welcome .error")
        assert "broken.tif" in tab.text("#welcome .error")
        tab.page.set_input_files("#heightmap-file", picture)
        tab.page.wait_for_function("() => document.querySelector('#welcome .error')?.textContent.includes('scale_m')")
        tab.page.fill("#welcome input[name=scale_m]", "0.01")
        tab.page.fill("#welcome input[name=resolution_m]", "1")
        tab.page.click("text=Send again")
        tab.page.wait_for_selector("#make")
        assert "grey.png" in tab.text("#step-map")


def test_a_service_that_is_away_for_a_moment(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.context.set_offline(True)
        tab.page.fill("#place-goal", "60, 150")
        tab.page.press("#place-goal", "Enter")
        tab.page.wait_for_selector("#banner:visible")
        assert "does not answer" in tab.text("#answer .error")
        tab.context.set_offline(False)
        tab.page.wait_for_selector("#banner", state="hidden")
        tab.page.click("text=Ask again")
        tab.drawn()


@pytest.mark.parametrize("view", [{}, {"viewport": PHONE, "color_scheme": "dark"}], ids=["wide", "phone, dark"])
def test_accessible(browser: Any, address: str, sample: str, view: dict[str, Any]) -> None:
    """axe-core finds nothing serious on any step."""
    from axe_core_python.sync_playwright import Axe

    axe = Axe()
    for hash in ("", sample):
        with opened(browser, address, hash=hash, **view) as tab:
            steps = [None]
            if hash:
                tab.drawn()
                steps = ["#tab-route", "#tab-map", "#tab-runs", "#tab-save"]
            for step in steps:
                if step is not None:
                    tab.page.click(step)
                found = axe.run(tab.page)["violations"]
                serious = [one for one in found if one["impact"] in ("serious", "critical")]
                assert not serious, [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in serious]


def test_policy_and_size(address: str) -> None:
    with httpx.Client(base_url=address) as client:
        for place in ("/", "/page/view3d.html"):
            policy = client.get(place).headers["content-security-policy"]
            scripts = re.search(r"script-src ([^;]*)", policy)
            assert scripts is not None
            assert scripts[1] == "'self'"
            assert "<script>" not in client.get(place).text
        assert client.get("/page/none.js").status_code == 404
        assert client.get("/page/..%2Fsettings.py").status_code == 404
        assert client.get("/page/leaflet/0.0.0/leaflet.js").status_code == 404
    size = sum(file.stat().st_size for file in WEB.iterdir() if file.suffix in (".js", ".css"))
    assert size < 120_000


def test_the_layers_lie_on_the_map(address: str) -> None:
    """Ground, prices and blocked ground of a small map, and what the page is told of them."""
    from joulemap.model.terrain.writers import write_geotiff

    with httpx.Client(base_url=address, timeout=60.0) as client:
        ground = client.post("/v1/heightmaps", params={"name": "hill.tif"}, content=write_geotiff(None, hill())).json()
        made = client.post(
            "/v1/costmaps",
            json={"heightmap_id": ground["id"], "model": "physics"},
            headers={"Prefer": "wait=60"},
        ).json()
        here = f"/v1/costmaps/{made['id']}"
        layers = client.get(f"{here}/layers").json()
        assert layers["bounds"] == made["frame"]["bounds"]
        assert layers["lat_lon"][0][0] == pytest.approx(
            [36.143, -3.0], abs=0.01
        )  # UTM 30 N: x 500 000 is 3 degrees west
        west, south, east, north = layers["bounds"]
        around = {"west": west, "south": south, "east": east, "north": north, "across": 10}
        roses = client.get(f"{here}/roses", params=around).json()
        assert len(roses["points"]) == len(roses["energy_per_m"]) == 10 * 7
        x, y = roses["points"][33]
        at = client.get(f"{here}/at", params={"x": x, "y": y}).json()
        assert roses["energy_per_m"][33] == pytest.approx(at["energy_per_m"], rel=1e-4)
        heights = [line["properties"]["height_m"] for line in client.get(f"{here}/contours").json()["features"]]
        assert heights == sorted(heights)
        assert heights
        for query in ({"layer": "ground"}, {"layer": "energy", "heading_deg": 45.0}, {"layer": "blocked"}):
            assert client.get(f"{here}/layer.png", params=query).content.startswith(b"\x89PNG")
