"""Ways through the page on a real service: own ground and robot, a slow job, the loop with its report, files, keys."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gpxpy
import httpx
import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.questions import feasibility, path
from joulemap.service.storage.owners import add_key
from joulemap.service.storage.store import Store
from tests.browser.chromium import PHONE, WIDE, inaccessible, opened
from tests.browser.conftest import serving
from tests.service.test_calibrations import ROBOT, hills, run_csv
from tests.unit.test_every_form_in_reports import Runs
from tests.unit.test_report import documented


def shot(tab: Any, name: str) -> None:
    """A picture for a person who looks at it, where one asks for pictures."""
    if folder := os.environ.get("JOULEMAP_PICTURES"):
        tab.page.wait_for_timeout(700)
        tab.page.screenshot(path=str(Path(folder) / f"{name}.png"))


def tif(folder: Path, heightmap: Heightmap, name: str) -> Path:
    file = folder / name
    file.write_bytes(write_geotiff(None, heightmap) or b"")
    return file


@pytest.fixture(scope="module")
def calibrated_on(browser: Any, address: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A link to a physics cost map of hilly ground, made on the page with a robot file."""
    folder = tmp_path_factory.mktemp("own")
    robot = folder / "robot.toml"
    robot.write_text("# a robot\n" + "".join(f"{key} = {value}\n" for key, value in ROBOT.items()))
    with opened(browser, address) as tab:
        tab.page.set_input_files("#heightmap-file", tif(folder, hills(), "hills.tif"))
        tab.page.wait_for_selector("#make")
        tab.page.set_input_files("input[accept='.toml']", robot)
        tab.page.wait_for_function("() => document.getElementById('robot').textContent.length > 0")
        assert float(tab.page.input_value("#robot input >> nth=0")) == ROBOT["mass_kg"]
        tab.page.wait_for_selector("#model option[value=physics]", state="attached")
        tab.page.select_option("#model", "physics")
        shot(tab, "own-ground")
        tab.page.click("#make")
        tab.page.wait_for_selector("#legend #scale")
        made = tab.page.evaluate("joulemap.now.costmap.robot")
        assert {key: made[key] for key in ROBOT} == ROBOT
        west, _, _, north = hills().frame.bounds
        tab.page.mouse.click(*tab.place(west + 8.0, north - 30.0))
        tab.page.mouse.click(*tab.place(west + 42.0, north - 10.0))
        tab.page.click("#tab-route")
        tab.drawn()
        tab.page.mouse.move(*tab.place(west + 20.0, north - 20.0))
        tab.page.wait_for_function("() => /J\\/m/.test(document.getElementById('readout').textContent)")
        assert "°" in tab.text("#readout")  # EPSG:32630 has latitudes
        shot(tab, "own-route")
        tab.page.wait_for_function("() => location.hash.includes('to=')")
        yield tab.page.evaluate("location.hash")


def test_the_loop(browser: Any, address: str, calibrated_on: str, tmp_path: Path) -> None:
    """Runs of which one has other names of columns; an effect is found; the route changes with the model."""
    plain, renamed = tmp_path / "run_01.csv", tmp_path / "run_02.csv"
    plain.write_bytes(run_csv(1, metres=70.0))
    head, *rows = run_csv(2, metres=70.0).decode().splitlines()
    assert head == "t,x,y,voltage,current"
    amperes = [row.rpartition(",") for row in rows]
    renamed.write_text(
        "\n".join(["q1,q2,q3,q4,q5", *(f"{rest},{1000 * float(last):.1f}" for rest, _, last in amperes)])
    )
    with opened(browser, address, hash=calibrated_on, accept_downloads=True) as tab:
        tab.drawn()
        before = tab.page.evaluate("joulemap.now.answer.energy_j")
        tab.page.click("#tab-runs")
        tab.page.set_input_files("#runs-files", renamed)
        tab.page.wait_for_selector("#columns select")
        assert tab.text("#columns tbody tr >> nth=0").split()[0] == rows[0].split(",")[0]
        for label, name in (
            ("Time (needed)", "q1"),
            ("x, east", "q2"),
            ("y, north", "q3"),
            ("Voltage", "q4"),
            ("Current (or power: needed)", "q5"),
        ):
            tab.page.select_option(f"#columns select[aria-label='{label}']", name)
        tab.page.select_option("#columns select[aria-label='unit of Current (or power: needed)']", "mA")
        shot(tab, "columns")
        assert not inaccessible(tab.page)
        tab.page.click("#columns button")
        tab.page.wait_for_selector("#sent .note")
        tab.page.set_input_files("#runs-files", plain)
        tab.page.wait_for_function("() => document.querySelector('#sent .note')?.textContent.includes('run_01.csv')")
        tab.page.wait_for_selector("#runs-list input >> nth=2")
        for box in tab.page.query_selector_all("#runs-list input"):
            box.check()
        tab.page.click("#calibrate")
        tab.page.wait_for_selector("#found h2", timeout=120_000)
        assert "turning" in tab.text("#found h2")
        tab.page.wait_for_selector("#measured svg")
        shot(tab, "found")
        assert not inaccessible(tab.page)
        with tab.page.expect_download() as waiting:
            tab.page.click("#found button:has-text('GPX')")
        assert b"<gpx" in Path(waiting.value.path()).read_bytes()
        with tab.context.expect_page() as waiting:
            tab.page.click("text=Whole report")
        report = waiting.value
        report.wait_for_load_state()
        for viewport, look in ((WIDE, "light"), (PHONE, "dark")):
            report.set_viewport_size(viewport)
            report.emulate_media(color_scheme=look)
            assert not inaccessible(report), (viewport, look)
        report.close()

        def _no_better(route: Any) -> None:
            answer = route.fetch()
            made = answer.json()
            made["report"]["confirmed_in_plans"] = False
            route.fulfill(response=answer, json=made)

        tab.page.route("**/v1/calibrations/cal-*", _no_better)
        tab.page.click("#calibrations button")
        tab.page.wait_for_selector("#found :text('Not confirmed for plans: keep the model that you have.')")
        assert tab.page.query_selector("#use-model") is None
        tab.page.unroute("**/v1/calibrations/cal-*")
        tab.page.click("#calibrations button")
        tab.page.click("#use-model")
        tab.page.wait_for_function("() => joulemap.now.before !== null", timeout=60_000)
        tab.page.wait_for_function("before => joulemap.now.answer?.energy_j > before", arg=before)  # turns cost
        shot(tab, "before-and-after")
        assert "before: model physics" in tab.text("#answer")
        tab.page.click("#tab-route")
        tab.page.click("#swap")
        tab.page.wait_for_function("() => joulemap.now.before === null")


@pytest.mark.slow
def test_whatever_is_found_is_shown(browser: Any, address: str, calibrated_on: str, monkeypatch: Any) -> None:
    """A report with an effect of every form, which cannot be distinguished, as `POST /v1/calibrations` answers it."""
    runs = Runs(compared=True)
    reports = [documented(runs.found(form, monkeypatch)).document for form in runs.one_of_each]
    effects = [report["effects"][0] for report in reports]
    report = reports[0] | {"effects": effects, "confounded": [[effect["name"] for effect in effects]]}
    with opened(browser, address, hash=calibrated_on) as tab:
        tab.drawn()
        made = {
            "id": "cal-1",
            "created_at": "2026-11-27T00:00:00Z",
            "model": "physics",
            "status": "done",
            "report": report,
        }
        made |= {"heightmap_id": tab.page.evaluate("joulemap.now.costmap.heightmap_id"), "calibrated_model": "cal-1"}
        tab.page.route("**/v1/calibrations?*", lambda route: route.fulfill(json={"items": [made], "total": 1}))
        tab.page.route("**/v1/calibrations/cal-1", lambda route: route.fulfill(json=made))
        tab.page.reload()
        tab.drawn()
        tab.page.click("#tab-runs")
        tab.page.click("#calibrations button")
        tab.page.wait_for_selector("#measured", state="attached")
        said = tab.text("#found")
        assert [effect["label"] for effect in effects if effect["label"] not in said] == []
        assert not re.search("NaN|undefined|null|Infinity", said)
        shot(tab, "every-form")


def test_areas_stops_and_reach(browser: Any, address: str, calibrated_on: str) -> None:
    with opened(browser, address, hash=calibrated_on) as tab:
        tab.drawn()
        west, _, _, north = hills().frame.bounds
        before = tab.page.evaluate("joulemap.now.answer.energy_j")
        tab.page.click("text=Draw an area")
        (x0, y0), (x1, y1) = tab.page.evaluate("[joulemap.now.start, joulemap.now.goal]")
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        for dx, dy in ((-4, -7), (4, -7), (4, 5), (-4, 5)):
            tab.page.mouse.click(*tab.place(x + dx, y + dy))
        tab.page.keyboard.press("Enter")
        tab.page.wait_for_function("before => joulemap.now.answer?.energy_j > before", arg=before)
        shot(tab, "avoid")
        tab.page.click("[aria-label='Remove area 1']")
        tab.page.wait_for_function("before => Math.abs(joulemap.now.answer?.energy_j - before) < 1e-6", arg=before)
        if tab.page.query_selector("#reach"):
            tab.page.click("#reach summary")
            tab.page.wait_for_selector("#reach-said p.note i")
            tab.page.click("text=Where must it turn back?")
            tab.page.check("#turn-back")
            tab.page.wait_for_selector("#homeward p")
            shot(tab, "reach")
        tab.page.click("text=Add stop")
        tab.page.mouse.click(*tab.place(west + 25.0, north - 8.0))
        tab.page.wait_for_function("() => joulemap.now.answer?.legs?.length === 3")
        assert "returns to the start" in tab.text("#stops")
        tab.page.check("#in-order")
        tab.page.wait_for_function("() => joulemap.now.answer?.legs?.length === 2")
        assert "ends at the last place" in tab.text("#stops")
        tab.page.wait_for_function("() => location.hash.includes('order=1')")
        tab.page.wait_for_selector("#profile svg")
        shot(tab, "stops")


def test_files(browser: Any, address: str, calibrated_on: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is planned again for them."""

    def _again(*_: object, **__: object) -> None:
        raise AssertionError("it is planned again")

    with opened(browser, address, hash=calibrated_on, accept_downloads=True) as tab:
        tab.drawn()
        monkeypatch.setattr(path, "ask", _again)
        tab.page.click("#tab-save")
        shot(tab, "save")

        def saved(words: str) -> bytes:
            with tab.page.expect_download() as waiting:
                tab.page.click(f"#step-save button:has-text('{words}')")
            return Path(waiting.value.path()).read_bytes()

        kinds = [one["properties"]["kind"] for one in json.loads(saved("GeoJSON"))["features"]]
        assert kinds[:2] == ["energy_optimal", "shortest"]
        assert b"<gpx" in saved("GPX")
        assert saved("PNG").startswith(b"\x89PNG")
        assert saved("GeoTIFF")[:2] in (b"II", b"MM")
        assert saved("Zarr").startswith(b"PK")
        monkeypatch.undo()
        tab.page.click("#tab-route")
        tab.page.check("#round-trip")
        tab.page.wait_for_function("() => joulemap.now.answer?.back")
        monkeypatch.setattr(feasibility, "ask", _again)
        tab.page.click("#tab-save")
        there = gpxpy.parse(saved("GPX").decode()).tracks
        assert [track.name for track in there] == ["way out", "way back"]
        ends = [(track.segments[0].points[0], track.segments[0].points[-1]) for track in there]
        assert ends[0][1].distance_2d(ends[1][0]) < 0.1
        assert ends[0][0].distance_2d(ends[1][1]) < 0.1


def test_a_slow_cost_map_shows_its_progress_and_is_cancelled(browser: Any, address: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rough = Heightmap(rng.random((600, 600)).astype(np.float32) * 0.05, GridFrame(0.0, 150.0, 0.25, 600, 600))
    with opened(browser, address, viewport=PHONE) as tab:
        tab.page.set_input_files("#heightmap-file", tif(tmp_path, rough, "rough.tif"))
        tab.page.wait_for_selector("#make")
        tab.page.click("summary:has-text('Cells and headings')")
        tab.page.fill("#spacing", "0.25")
        tab.page.fill("#headings", "180")
        tab.page.click("#make")
        tab.page.wait_for_selector("#cancel")
        tab.page.wait_for_function("() => /%/.test(document.getElementById('making').textContent)")
        shot(tab, "progress-phone")
        tab.page.click("#cancel")
        tab.page.wait_for_function("() => document.getElementById('making').textContent.includes('Cancelled')")


def test_what_a_cost_map_may_not_be_is_said_in_words(browser: Any, address: str, tmp_path: Path) -> None:
    flat = Heightmap(np.zeros((40, 40), dtype=np.float32), GridFrame(0.0, 40.0, 1.0, 40, 40))
    with opened(browser, address) as tab:
        tab.page.set_input_files("#heightmap-file", tif(tmp_path, flat, "flat.tif"))
        tab.page.wait_for_selector("#make")
        tab.page.click("summary:has-text('Cells and headings')")
        tab.page.fill("#spacing", "5000")
        tab.page.click("#make")
        tab.page.wait_for_selector("#making .error")
        assert "5000" in tab.text("#making .error")


def test_a_service_with_keys_asks_for_one(browser: Any, tmp_path: Path) -> None:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'joulemap.db'}")
    store.open()
    key = add_key(store.sessions, "somebody")
    store.close()
    with serving(tmp_path) as url, opened(browser, url) as tab:
        assert httpx.get(f"{url}/v1/costmaps").status_code == 401
        assert not inaccessible(tab.page)
        tab.page.fill("dialog input", key)
        tab.page.click("dialog button")
        tab.page.wait_for_function("() => document.querySelector('#welcome')?.textContent.includes('Nothing yet')")


@pytest.mark.parametrize(
    ("viewport", "look"),
    [
        pytest.param(WIDE, "light", id="wide, light"),
        pytest.param(PHONE, "dark", id="phone, dark", marks=pytest.mark.slow),
        pytest.param(WIDE, "dark", id="wide, dark", marks=pytest.mark.slow),
        pytest.param(PHONE, "light", id="phone, light", marks=pytest.mark.slow),
    ],
)
def test_areas_of_the_ground_are_drawn_and_the_cost_map_has_them(
    browser: Any, address: str, calibrated_on: str, viewport: dict[str, int], look: str
) -> None:
    """Mud with a rolling resistance, and an obstacle: more for a metre in the first, and none in the second."""
    with opened(browser, address, hash=calibrated_on, viewport=viewport, color_scheme=look) as tab:
        tab.page.wait_for_selector("#again", state="attached")
        before = tab.page.evaluate("joulemap.now.costmap.id")
        west, _, _, north = hills().frame.bounds
        tab.page.click("#tab-map")
        tab.page.click("#again")
        tab.page.click("#known-ground summary")
        for x, y in ((14.0, 14.0), (30.0, 14.0)):
            tab.page.click("#ground-areas > button")
            for dx, dy in ((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)):
                tab.page.mouse.click(*tab.place(west + x + dx, north - y + dy))
            tab.page.keyboard.press("Enter")
        tab.page.wait_for_selector("#ground-areas fieldset >> nth=1")
        tab.page.fill("#ground-areas fieldset:nth-of-type(1) input[type=number]", "0.4")
        tab.page.select_option("#ground-areas fieldset:nth-of-type(2) select", "obstacles")
        assert inaccessible(tab.page) == []
        shot(tab, f"ground-{viewport['width']}-{look}")
        tab.page.click("#make")
        tab.page.wait_for_function("before => joulemap.now.costmap?.id !== before", arg=before)
        made = tab.page.evaluate("joulemap.now.costmap")
        shot(tab, f"ground-made-{viewport['width']}-{look}")
    assert [layer["role"] for layer in made["provenance"]["layers"]] == ["kinds", "obstacles"]
    with httpx.Client(base_url=address) as client:
        prices, blocked = [], []
        for costmap_id in (before, made["id"]):
            answers = [
                client.get(f"/v1/costmaps/{costmap_id}/at", params={"x": west + x, "y": north - 14.0}).json()
                for x in (14.0, 30.0)
            ]
            prices.append(max(value for value in answers[0]["energy_per_m"] if value is not None))
            blocked.append(set(answers[1]["blocked"]))
    more = 0.4 - made["robot"]["rolling_resistance"]  # uphill, where all of it counts
    assert prices[1] - prices[0] == pytest.approx(more * made["robot"]["mass_kg"] * 9.80665, rel=1e-3)
    assert "obstacle" not in blocked[0]
    assert blocked[1] == {"obstacle"}
