"""`joulemap info`: what a heightmap holds, and what it can show to a robot; on surveys of one ground."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cli import app


def answer(*words: str) -> dict[str, Any]:
    """The document of a command, in this process."""
    result = CliRunner().invoke(app, [*words, "--json", "-"])
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout) | {"said": result.stderr}


@pytest.fixture(scope="module")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Heightmaps of one ground, as others survey it."""
    made = {}
    for name in ("scanner", "robot", "national"):
        out = tmp_path_factory.mktemp(name)
        answer("simulate", "--out", str(out), "--site", "dirt", "--runs", "1", "--survey", name)
        made[name] = out / "dem.tif"
    logs = {(file.parent / "run_01.csv").read_bytes() for file in made.values()}
    assert len(logs) == 1  # the same ground was driven
    return made


def test_noise_cells_and_steps_of_three_surveys(surveys: dict[str, Path]) -> None:
    scanner, robot, national = (answer("info", str(surveys[name])) for name in ("scanner", "robot", "national"))
    assert (robot["rows"], robot["resolution_m"], national["rows"], national["resolution_m"]) == (400, 0.1, 40, 1.0)
    assert robot["crs"] == "EPSG:32615"
    assert scanner["noise_m"] < 0.008
    assert 0.017 < robot["noise_m"] < 0.023
    assert 0.07 < national["noise_m"] < 0.13
    assert scanner["least_step_m"] < robot["least_step_m"] < 0.18
    assert national["least_step_m"] is None
    assert "cells are wider than a wheel" in national["said"]
    assert "may be hidden" in robot["said"]


def test_the_slope_of_a_square_metre_is_as_uncertain_as_said(surveys: dict[str, Path]) -> None:
    given = answer("info", str(surveys["national"]), "--noise", "0.2")
    assert given["noise_given"]
    side = np.arange(2) - 0.5  # the four heights that a plane over a metre goes through
    rise = np.random.default_rng(0).normal(0.0, 0.2, (20_000, 2, 2)) @ np.ones(2) @ side / (2 * (side**2).sum())
    assert given["slope_std_deg"] == pytest.approx(np.degrees(np.arctan(rise.std())), rel=0.03)


def test_a_file_that_is_no_heightmap_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dem.tif").write_bytes(b"no raster")
    result = CliRunner().invoke(app, ["info", str(tmp_path / "dem.tif")])
    assert result.exit_code == 3
    assert "dem.tif" in result.stderr


def test_layers_are_counted_and_drawn(tmp_path):
    """Mud over a quarter of the map, a house and a deck: the picture differs by each."""
    frame = GridFrame(0.0, 40.0, 0.5, 80, 80)
    write_geotiff(tmp_path / "dem.tif", Heightmap(np.zeros(frame.shape, dtype=np.float32), frame))

    def _box(west: float, south: float, east: float, north: float, **said: object) -> dict:
        ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
        return {"type": "Feature", "properties": said, "geometry": {"type": "Polygon", "coordinates": [ring]}}

    layers = {
        "kinds": _box(0, 0, 10, 40, kind="mud"),
        "obstacles": _box(20, 20, 30, 30),
        "height": _box(30, 0, 34, 4, height=2),
    }
    words, pictures = ["info", str(tmp_path / "dem.tif")], set()
    for role, polygons in layers.items():
        (tmp_path / f"{role}.geojson").write_text(json.dumps(polygons))
        words += ["--layer", f"{role}={tmp_path / role}.geojson"]
        said = answer(*words, "--picture", str(tmp_path / "seen.png"))
        pictures.add((tmp_path / "seen.png").read_bytes())
    assert len(pictures) == 3
    assert said["kinds"]["mud"] == pytest.approx(0.25, abs=0.01)
    assert [layer["role"] for layer in said["layers"]] == ["kinds", "obstacles", "height"]
    assert any("gives the heights of 16.0 m2" in words for words in said["warnings"])
    assert said["heights_m"] == [0.0, 2.0]
