"""A new user's walk: the same ground, robot and questions on the command line, in Python, over HTTP and on the page."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import InputError
from joulemap.model.terrain.writers import write_geotiff
from tests.browser.chromium import opened
from tests.service.conftest import GOAL, IN_HOLE, NORTH, START, hill
from tests.service.test_cli import joulemap

BESIDE = [START[0] + 10.0, START[1] - 8.0]
ENDS = ",".join(map(str, START)), ",".join(map(str, GOAL))


def test_every_face_gives_the_same_answers(browser: Any, address: str, tmp_path: Path) -> None:
    dem, folder, points = tmp_path / "dem.tif", tmp_path / "map.zarr", tmp_path / "points.csv"
    write_geotiff(dem, hill())
    points.write_text("\n".join(["x,y", *(f"{x},{y}" for x, y in (START, GOAL, BESIDE))]))

    # on the command line: which robot it took, and energies between many places
    code, words, errors = joulemap("costmap", dem, "--model", "physics", "--out", folder)
    assert code == 0, errors
    assert "35 kg" in words + errors
    code, words, errors = joulemap("matrix", folder, points, "--json", "-")
    assert code == 0, errors
    table = json.loads(words)["energies_j"]
    code, words, errors = joulemap("path", folder, "--start", ENDS[0], "--goal", f"{IN_HOLE[0]},{IN_HOLE[1]}")
    assert code != 0
    assert "--snap" in words + errors  # as the command calls it
    code, words, errors = joulemap(
        "path", folder, "--start", ENDS[0], "--goal", ENDS[1], "--json", "-", "--out", tmp_path / "way.json",
        "--format", "ros-path", "--origin", "start",
    )  # fmt: skip
    assert code == 0, errors
    energy_j = json.loads(words)["energy_j"]
    poses = json.loads((tmp_path / "way.json").read_text())["poses"]
    assert poses[0]["pose"]["position"]["x"] == pytest.approx(0.0, abs=1e-6)  # not 500 km, of which float32 has steps

    # in Python
    ground = jm.open_costmap(folder)
    assert ground.matrix([START, GOAL, BESIDE], [START, GOAL, BESIDE]).energies_j == pytest.approx(np.array(table))
    assert ground.plan(START, GOAL).energy_j == pytest.approx(energy_j)
    mask = np.zeros((30, 40), dtype=bool)
    mask[13:18, 18:23] = True
    assert ground.plan(START, GOAL, avoid=mask).energy_j >= 0.998 * energy_j
    with pytest.raises((InputError, TypeError), match="mass_kg"):
        jm.Robot(mass=3)  # type: ignore[call-arg]
    assert pickle.loads(pickle.dumps(ground)).plan(START, GOAL).energy_j == pytest.approx(energy_j)
    own = jm.costmap(dem, model=lambda along, across, roughness, speed: 60.0 + 340.0 * along)
    side_by_side = jm.compare({"equation 5": ground, "own": own}, START, GOAL)
    assert side_by_side.routes["equation 5"].energy_j == pytest.approx(energy_j)

    # over HTTP
    with httpx.Client(base_url=address, timeout=300.0) as http:
        heightmap = http.post("/v1/heightmaps", files={"file": ("hill.tif", dem.read_bytes())}).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        costmap = http.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"}).json()
        here = f"/v1/costmaps/{costmap['id']}"
        many = http.post(f"{here}/matrix", json={"starts": [START, GOAL, BESIDE], "goals": [START, GOAL, BESIDE]})
        assert np.array(many.json()["energies_j"]) == pytest.approx(np.array(table), rel=1e-6)
        refused = http.post(f"{here}/paths", json={"start": START, "goal": IN_HOLE})
        assert refused.status_code == 422
        assert "nearest free place" in refused.json()["detail"]

    # on the page
    with opened(browser, address, hash=f"#map={costmap['id']}&from={ENDS[0]}&to={ENDS[1]}") as tab:
        tab.drawn()
        assert tab.page.evaluate("joulemap.now.answer.energy_j") == pytest.approx(energy_j, rel=1e-6)
        assert len(tab.text("#answer .verdict").split("\n\n")) <= 3  # the verdict, its first reason, and what unfolds
        for step in ("map", "route", "runs"):
            tab.page.click(f"#tab-{step}")
            assert tab.page.is_visible("#legend #scale")
        assert "step" in tab.text("#legend")  # the wall, in its own colour
        tab.page.mouse.move(*tab.place(START[0] + 7.5, NORTH - 3.5))
        tab.page.wait_for_function("() => document.getElementById('readout').textContent.includes('step')")
        tab.page.click("#view-3d")
        tab.page.frame_locator("iframe").locator("#view[data-drawn]").wait_for()
        tab.page.click("#dialog-3d button")
        tab.page.click("#tab-save")
        with tab.page.expect_download() as waiting:  # the route that is shown, without planning it again
            tab.page.click("#step-save button:has-text('GPX')")
        assert b"<gpx" in Path(waiting.value.path()).read_bytes()
