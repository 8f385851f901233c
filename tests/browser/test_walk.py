"""What a new user meets: what ground is, a goal that no way leads to, a route to take along, a drive to suggest."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from joulemap.model.terrain.writers import write_geotiff
from tests.browser.chromium import opened
from tests.service.conftest import GOAL, NORTH, START, hill
from tests.service.test_cli import joulemap

ENDS = ",".join(map(str, START)), ",".join(map(str, GOAL))


def test_the_page_says_what_ground_is_and_saves_the_route_that_it_shows(
    browser: Any, address: str, tmp_path: Path
) -> None:
    """Where no way leads, it says what closes it, as commands do: `tests/service/test_closed_way.py`."""
    heights = np.zeros((30, 40), dtype=np.float32)
    heights[8:21, 22:35] = 3.0
    heights[10:19, 24:33] = 0.0  # a court without a gate
    court = replace(hill(), heights=heights)
    made = []
    with httpx.Client(base_url=address, timeout=300.0) as http:
        for content in (write_geotiff(None, hill()), write_geotiff(None, court)):
            sent = http.post("/v1/heightmaps", content=content).json()["id"]
            body = {"heightmap_id": sent, "model": "physics"}
            made.append(http.post("/v1/costmaps", json=body, headers={"Prefer": "wait=300"}).json()["id"])
    with opened(browser, address, hash=f"#map={made[0]}&from={ENDS[0]}&to={ENDS[1]}") as tab:
        tab.drawn()
        assert len(tab.text("#answer .verdict").split("\n\n")) <= 3  # the verdict, its first reason, and what unfolds
        for step in ("map", "route", "runs"):
            tab.page.click(f"#tab-{step}")
            assert tab.page.is_visible("#legend #scale")
        assert "step" in tab.text("#legend")  # the wall, in its own colour
        tab.page.mouse.move(*tab.place(START[0] + 7.5, NORTH - 3.5))
        tab.page.wait_for_function("() => document.getElementById('readout').textContent.includes('step')")
        tab.page.click("#tab-save")
        with tab.page.expect_download() as waiting:  # the route that is shown, without planning it again
            tab.page.click("#step-save button:has-text('GPX')")
        assert b"<gpx" in Path(waiting.value.path()).read_bytes()
    inside = f"{START[0] + 25.0},{START[1] + 1.0}"
    with opened(browser, address, hash=f"#map={made[1]}&from={ENDS[0]}&to={inside}") as tab:
        tab.page.wait_for_selector("#answer .error")
        assert "step" in tab.text("#answer .error")


def test_a_drive_is_suggested_from_the_runs_alone(tmp_path: Path) -> None:
    assert joulemap("simulate", "--out", tmp_path / "site", "--runs", "2", "--seed", "3")[0] == 0
    site = tmp_path / "site"
    drives = "--heightmap", site / "dem.tif", "--robot", site / "robot.toml", "--runs", site, "--model", "physics"
    code, words, errors = joulemap("suggest-drive", *drives, "--length", "60", "--json", "-")
    assert code == 0, errors
    assert json.loads(words)["length_m"] <= 75.0
