"""The page in a browser: from nothing to a route, by mouse, keyboard and link; errors in words; accessible."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.transform import from_origin

from joulemap.service.render import raster_shading
from tests.browser.chromium import PHONE, WIDE, inaccessible, opened
from tests.service.conftest import hill

WEB = Path(__file__).resolve().parents[2] / "service" / "web"
SAMPLE_ENDS = [[22, 96], [178, 104]]


@pytest.fixture(scope="module")
def sample(browser: Any, address: str) -> str:
    """The link to the sample with its route, as somebody gets it who clicks on the sample and does nothing else.

    It leads to a cost map of cells of 2 m, which is asked four times as fast.
    """
    with opened(browser, address) as tab:
        tab.page.click("#sample")
        tab.drawn()
        assert "the battery lasts" in tab.text("#answer").lower()
        assert re.search(r"saves [\d.,]+ Wh \(\d", tab.text("#answer"))
        assert float(tab.text("#answer tbody tr:first-child").split("%")[0].split()[-1]) > 20.0  # of the battery
        tab.page.wait_for_function("() => location.hash.includes('to=')")
        link, made = tab.page.evaluate("[location.hash, joulemap.now.costmap]")
    wish = {"heightmap_id": made["heightmap_id"], "spacing_m": 2.0}
    coarse = httpx.post(f"{address}/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}, timeout=310.0).json()
    return link.replace(made["id"], coarse["id"])


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
        assert "http" not in tab.response.headers["content-security-policy"]  # no base map is set, and none offered
        assert tab.page.locator(".leaflet-control-layers, .leaflet-control-attribution").count() == 0


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
        tab.page.wait_for_function("() => joulemap.now.start[1] === 98")
        tab.page.wait_for_function("() => joulemap.now.answer?.path?.[0][1] === 98")
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


@pytest.mark.parametrize(
    ("viewport", "look"),
    [
        pytest.param(WIDE, "light", id="wide, light"),
        pytest.param(PHONE, "dark", id="phone, dark", marks=pytest.mark.slow),
        pytest.param(WIDE, "dark", id="wide, dark", marks=pytest.mark.slow),
        pytest.param(PHONE, "light", id="phone, light", marks=pytest.mark.slow),
    ],
)
def test_accessible(browser: Any, address: str, sample: str, viewport: dict[str, int], look: str) -> None:
    """axe-core finds nothing serious: first steps, all panels with what they unfold, and the 3-D view."""
    view = {"viewport": viewport, "color_scheme": look}
    with opened(browser, address, **view) as tab:
        tab.page.click("#welcome summary")
        assert not inaccessible(tab.page)
    with opened(browser, address, hash=f"{sample}&others=2&back=1", **view) as tab:
        tab.drawn()
        for step in ("route", "map", "runs", "save"):
            tab.page.click(f"#tab-{step}")
            tab.page.evaluate("document.querySelectorAll('#panel details').forEach(one => { one.open = true; })")
            assert not inaccessible(tab.page), step
        assert not any("plotly.min.js" in url for url in tab.asked)  # several megabytes, only when somebody wants them
        tab.page.click("#view-3d")
        tab.page.frame_locator("iframe").locator("#view[data-drawn]").wait_for()
        assert not inaccessible(tab.page)
        assert not inaccessible(tab.page.frames[1])


def test_a_click_while_looking_around_moves_nothing_and_what_was_moved_comes_back(
    browser: Any, address: str, sample: str
) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.page.mouse.click(*tab.place(60.0, 150.0))
        tab.page.wait_for_timeout(100)
        assert ends(tab) == SAMPLE_ENDS
        tab.page.click("text=Set goal")
        tab.page.mouse.click(*tab.place(60.0, 150.0))
        tab.page.wait_for_function("() => joulemap.now.goal[1] > 140")
        tab.page.mouse.click(*tab.place(100.0, 40.0))  # the button asked for one click
        tab.page.wait_for_timeout(100)
        assert ends(tab)[1] == pytest.approx([60.0, 150.0], abs=2.0)
        tab.page.click("text=Undo")
        tab.page.wait_for_function("() => joulemap.now.goal[1] < 140")
        assert ends(tab) == SAMPLE_ENDS
        tab.drag(".pin.goal", 60.0, 150.0)
        tab.page.wait_for_function("() => joulemap.now.goal[1] > 140")
        tab.page.keyboard.press("Control+z")
        tab.page.wait_for_function("() => joulemap.now.goal[1] < 140")
        assert ends(tab) == SAMPLE_ENDS
        assert tab.page.is_disabled("text=Undo")


def test_another_battery_and_a_charge_that_is_typed(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        full = energy(tab) / 3600.0 / 0.1  # ten per cent of such a battery
        for box, value in (
            ("#capacity", f"{full:.3f}"),
            ("#charge input[type=number]", "60"),
            ("#reserve input >> nth=1", "5"),
        ):
            tab.page.fill(box, value)
            tab.page.press(box, "Enter")
        tab.page.wait_for_function(
            "() => /60 % at the start, 50.0 % expected/.test(document.querySelector('.verdict')?.textContent)"
        )
        tab.page.wait_for_function("() => /battery=0.6,0.05,/.test(location.hash)")
        assert tab.page.input_value("#charge input[type=range]") == "60"
        assert "10.0 %" in tab.text("#answer table")
        assert "kJ" not in tab.text("body")
        link = tab.page.evaluate("location.hash")
    with opened(browser, address, hash=link) as tab:
        tab.drawn()
        assert float(tab.page.input_value("#capacity")) == pytest.approx(full, abs=1e-3)


def test_reach_is_shown_with_the_route_and_the_map_does_not_move(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample.split("&from=")[0]) as tab:
        tall = tab.page.evaluate("joulemap.map.getSize().y")
        for place in SAMPLE_ENDS:
            tab.page.mouse.click(*tab.place(*place))
        tab.drawn()
        assert tab.page.evaluate("joulemap.map.getSize().y") == tall
        tab.page.click("#reach summary")
        tab.page.wait_for_selector("#reach-said i")
        assert tab.page.is_visible(".leaflet-reach-pane path")
        tab.page.click("#tab-map")
        assert not tab.page.is_visible(".leaflet-reach-pane path")
        tab.page.click("#again")
        tab.page.click("text=Cancel")
        tab.page.wait_for_selector("#legend #scale")


def test_a_route_for_bad_cases_and_a_limit_of_power(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.page.click("text=Route options")
        tab.page.select_option("#objective", "quantile")
        tab.page.wait_for_function("() => joulemap.now.answer?.objective?.name === 'quantile'")
        assert "95 % of drives take at most" in tab.text("#answer")
        tab.page.fill("#power", "1")
        tab.page.press("#power", "Enter")
        tab.page.wait_for_selector("#answer .error")
        tab.page.wait_for_function("() => /max_power_w=1/.test(location.hash)")


def test_the_question_by_keyboard_alone(browser: Any, address: str, sample: str) -> None:
    """Space sets a place in the middle of the map, under which the arrow keys move the map."""
    with opened(browser, address, hash=sample.split("&from=")[0]) as tab:
        tab.page.focus("#map")
        tab.page.keyboard.press("ArrowLeft")
        tab.page.wait_for_function("() => document.getElementById('readout').textContent.includes('J/m')")
        tab.page.keyboard.press("Space")
        tab.page.wait_for_selector(".pin.start")
        (x, y), _ = ends(tab)
        middle = tab.page.evaluate("(({ lng, lat }) => [lng, lat])(joulemap.map.getCenter())")
        assert [x, y] == pytest.approx(middle, abs=0.01)
        tab.page.keyboard.press("ArrowDown")
        tab.page.wait_for_function("y => joulemap.map.getCenter().lat < y - 5", arg=y)
        tab.page.keyboard.press("Space")
        tab.drawn()
        assert ends(tab)[1][1] < y - 5.0
        assert tab.page.get_attribute("#tab-route", "aria-selected") == "true"


def test_a_place_on_blocked_ground_is_moved_when_asked(browser: Any, address: str, sample: str) -> None:
    with opened(browser, address, hash=sample) as tab:
        tab.drawn()
        tab.page.fill("#place-goal", "40, 84")
        tab.page.press("#place-goal", "Enter")
        tab.page.click("#snap")
        tab.drawn()
        assert ends(tab)[1] == pytest.approx([40.0, 84.0], abs=12.0)
        assert ends(tab)[1] != [40, 84]


def test_a_large_map_is_fine_where_it_is_near(
    browser: Any, address: str, sample: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the picture of the whole map had 64 pixels: pieces of it come, in the view that is chosen."""
    monkeypatch.setattr(raster_shading, "MAX_PIXELS", 64)
    with opened(browser, address, hash=f"{sample}&at=60,60,40") as tab:
        tab.page.wait_for_selector(".leaflet-image-layer.piece", state="attached")
        tab.page.click("#tab-map")
        tab.page.check("text=Ground only")
        tab.page.wait_for_function("() => document.querySelectorAll('.piece').length > 0")
        assert any("/piece.png?level=0&row=0&col=0&view=ground" in url for url in tab.asked)
        tab.page.evaluate("joulemap.map.setZoom(-3)")
        tab.page.wait_for_function("() => document.querySelectorAll('.piece').length === 0")


def test_an_answer_that_comes_late_leaves_the_tab_that_was_chosen(browser: Any, address: str, sample: str) -> None:
    held: list[Any] = []
    with opened(browser, address) as tab:
        tab.page.route("**/paths", lambda route: held.append(route))
        tab.page.goto("about:blank")
        tab.page.goto(f"{address}/{sample}")
        tab.page.wait_for_selector("#tab-route[aria-selected=true]")
        with tab.page.expect_response("**/paths"):
            tab.page.click("#tab-map")
            while not held:
                tab.page.wait_for_timeout(20)
            held.pop().continue_()
        tab.page.wait_for_selector("#answer .verdict", state="attached")
        assert tab.page.get_attribute("#tab-map", "aria-selected") == "true"


def test_a_map_in_degrees_is_resampled(browser: Any, address: str, tmp_path: Path) -> None:
    file = tmp_path / "degrees.tif"
    heights = np.add.outer(np.linspace(0.0, 2.0, 40), np.linspace(0.0, 1.0, 50)).astype(np.float32)
    shape = {"width": 50, "height": 40, "count": 1, "dtype": "float32", "driver": "GTiff"}
    with rasterio.open(file, "w", crs="EPSG:4326", transform=from_origin(-3.0, 36.0, 1e-5, 1e-5), **shape) as made:
        made.write(heights, 1)
    with opened(browser, address) as tab:
        tab.page.set_input_files("#heightmap-file", file)
        tab.page.wait_for_selector("#welcome .error")
        assert "in degrees (EPSG:4326)" in tab.text("#welcome .error")
        tab.page.click("button#reproject")
        tab.page.wait_for_selector("#make")
        assert "UTM zone" in tab.text("#step-map")


def test_the_numbers_of_an_axis_have_room(browser: Any, address: str) -> None:
    """A route along a contour line differs in height by micrometres."""
    ranges = [[29.4646, 29.46461], [2000.0, 2000.00001], [0.0, 0.0], [120.0, 128.0], [-1.0, -0.9999999]]
    with opened(browser, address) as tab:
        for low, high in ranges:
            numbers = tab.page.evaluate(
                """async ([low, high]) => {
              const { axes } = await import("/page/profile.js"), box = { left: 0, top: 0, width: 300, tall: 190 };
              const words = axes("height", "m", low, high, box, 100).parts.filter(one => one.textContent);
              return words.filter(one => one.getAttribute("text-anchor") === "end").map(one => one.textContent);
            }""",
                [low, high],
            )
            assert 2 <= len(numbers) <= 5, (low, numbers)
            assert len(set(numbers)) == len(numbers), (low, numbers)
            assert max(map(len, numbers)) <= 7, (low, numbers)


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
    assert size < 200_000


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
