"""A drive that is watched on the page: the marker moves, the battery curve bends, the band narrows, alarms are said."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from tests.browser.chromium import PHONE, WIDE, inaccessible, opened
from tests.browser.test_flows import shot, tif
from tests.service.test_calibrations import ROBOT, hills

SPEED_MPS = 0.5


@pytest.fixture(scope="module")
def service(address: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=address, timeout=120.0) as client:
        yield client


@pytest.fixture(scope="module")
def costmap(service: httpx.Client, browser: Any, tmp_path_factory: pytest.TempPathFactory) -> str:
    sent = service.post("/v1/heightmaps", content=tif(tmp_path_factory.mktemp("d"), hills(), "hills.tif").read_bytes())
    wish = {"heightmap_id": sent.json()["id"], "model": "physics", "robot": ROBOT}
    return str(service.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=100"}).json()["id"])


def begun(service: httpx.Client, costmap: str) -> tuple[str, list[dict[str, Any]]]:
    """A drive, and samples of it that take 1.4 times what was planned, and from half way on a third of that."""
    west, _, _, north = hills().frame.bounds
    ends = {"start": [west + 6.0, north - 34.0], "goal": [west + 44.0, north - 6.0]}
    found = service.post(f"/v1/costmaps/{costmap}/paths", json=ends).json()
    drive = service.post(
        f"/v1/costmaps/{costmap}/drives",
        json={"path": found["path"], "battery": {"charge": 0.6, "reserve": 0.2, "capacity_wh": 12.0}},
    )
    assert drive.status_code == 201, drive.text
    at, x, y, energy = (
        np.array([0.0, *(piece[key] for piece in found["profile"])]) for key in ("distance_m", "x", "y", "cumulative_j")
    )
    x[0], y[0] = found["path"][0][:2]
    places = np.append(np.arange(0.0, at[-1], 0.25), at[-1])
    planned_w = np.gradient(np.interp(places, at, energy), places) * SPEED_MPS
    power = planned_w * np.where(places < at[-1] / 2, 1.4, 0.45)
    log = [
        {
            "time_s": float(d / SPEED_MPS),
            "position": [float(np.interp(d, at, x)), float(np.interp(d, at, y))],
            "power_w": float(p),
        }
        for d, p in zip(places, power, strict=True)
    ]
    return drive.json()["id"], log


def seen(tab: Any) -> dict[str, Any]:
    """The robot on the map, the ends of the curve that is expected, and the width of its band at the end."""
    found: dict[str, Any] = tab.page.evaluate(
        """() => {
      const numbers = path => path.getAttribute("d").match(/[\\d.]+/g).map(Number);
      const svg = document.querySelector("#drive-curve svg"), one = name => svg.querySelector(name);
      const expected = numbers(one(".curve:not(.height, .driven)")), band = numbers(one(".band"));
      const last = band.length / 2, robot = document.getElementById("robot-now").getBoundingClientRect();
      const width = band[last + 1] - band[last - 1];
      return { robot: [robot.x, robot.y], end: expected.at(-1), band: width, now: +one("circle").getAttribute("cx") };
    }"""
    )
    return found


@pytest.mark.slow
def test_a_drive_is_watched_as_it_happens(browser: Any, address: str, service: httpx.Client, costmap: str) -> None:
    drive, log = begun(service, costmap)
    url, half = f"/v1/drives/{drive}/updates", len(log) // 2
    with opened(browser, address, hash=f"#map={costmap}") as tab:
        tab.page.click("#tab-drives")
        tab.page.click("#drives-list tbody button >> nth=0")
        tab.page.wait_for_selector("#drive-curve svg")
        before = seen(tab)
        assert "nothing is learnt yet" in tab.text("#drive")
        service.post(url, json={"samples": log[: half // 2]})
        tab.page.wait_for_function(
            "() => /driving takes|takes \\d+ % more/.test(document.getElementById('drive').textContent)"
        )
        tab.page.wait_for_function(
            "x => document.querySelector('#drive-curve circle').getAttribute('cx') > x + 20", arg=before["now"]
        )
        after = seen(tab)
        assert after["robot"] != before["robot"]
        assert after["end"] > before["end"] + 3.0  # lower on the screen: less is left
        assert 0.0 < after["band"] < before["band"]
        assert not tab.page.query_selector("#drive .warn")
        shot(tab, "drive-1440-light")
        service.post(url, json={"samples": log[half // 2 :]})
        tab.page.wait_for_selector("#drive .warn")
        assert "takes less than" in tab.text("#drive .warn >> nth=-1")
        tab.page.wait_for_selector("text=The robot has arrived")
        assert not inaccessible(tab.page)
        link = tab.page.evaluate("location.hash")
        assert f"drive={drive}" in link
    for name, options in (
        ("1440-dark", {"viewport": WIDE}),
        ("390-light", {"viewport": PHONE}),
        ("390-dark", {"viewport": PHONE}),
    ):
        with opened(browser, address, hash=link, color_scheme=name.rpartition("-")[2], **options) as tab:
            tab.page.wait_for_selector("#drive-curve svg")
            assert tab.page.get_attribute("#tab-drives", "aria-selected") == "true"
            assert not inaccessible(tab.page)
            assert tab.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            shot(tab, f"drive-{name}")
            tab.page.locator("#drive").scroll_into_view_if_needed()
            shot(tab, f"drive-{name}-panel")
    with opened(browser, address, hash=link) as tab:
        tab.page.click("text=Delete this drive")
        tab.page.wait_for_function("() => !joulemap.now.drive && !document.getElementById('drive').textContent")
    assert service.get(f"/v1/drives/{drive}").status_code == 404


def test_a_log_is_replayed_as_if_live(
    browser: Any, address: str, service: httpx.Client, costmap: str, tmp_path: Path
) -> None:
    _, log = begun(service, costmap)
    rows = [f"{one['time_s']},{one['position'][0]},{one['position'][1]},{one['power_w']}" for one in log]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,x,y,power_w", *rows]))
    (tmp_path / "bad.csv").write_text("time_s,x,y\n1,2,3\n")
    with opened(browser, address, hash=f"#map={costmap}") as tab:
        tab.page.click("#tab-drives")
        tab.page.click("text=Replay a log")
        tab.page.set_input_files("#replay-file", tmp_path / "bad.csv")
        tab.page.wait_for_selector("#replay-said .error")
        assert "needs t, x, y, and power" in tab.text("#replay-said")
        tab.page.fill("#replay-speed", "60")
        tab.page.set_input_files("#replay-file", tmp_path / "log.csv")
        tab.page.wait_for_selector("#drive-curve svg")
        tab.page.wait_for_selector("text=All of the log is sent.")
        tab.page.wait_for_function(
            "() => /\\d+ % (more|less)|as planned/.test(document.getElementById('drive').textContent)"
        )
        drive = tab.page.evaluate("joulemap.now.drive")
    assert service.get(f"/v1/drives/{drive}").json()["forecast"]["learnt_m"] > 30.0
