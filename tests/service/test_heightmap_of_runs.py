"""A heightmap of driven positions: on the command line and in Python, one of all runs or one of each."""

import json
import tomllib

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import HeightmapError, RunsError
from tests.service.test_cli import joulemap


def ground(x, y):
    """Waves of 12 m on a slope of 3 %."""
    return 200.0 + 0.03 * x + 0.2 * np.sin(x * 2.0 * np.pi / 12.0) * np.cos(y * 2.0 * np.pi / 12.0)


def drive(folder, name, *, lanes=(0.0, 1.0, 2.0, 3.0), lift_m=0.0, with_z=True):
    """A log at 10 Hz and 0.5 m/s to and fro over lanes of 15 m, whose heights err by 1 cm."""
    rng = np.random.default_rng(len(name))
    along = np.arange(0.0, 15.0, 0.05)
    x = np.concatenate([along if k % 2 == 0 else along[::-1] for k in range(len(lanes))])
    y = np.repeat(lanes, along.size) + rng.normal(0.0, 0.02, x.size)
    z = ground(x, y) + 0.4 + lift_m + rng.normal(0.0, 0.01, x.size)
    t = 0.1 * np.arange(x.size)
    columns = {"t": t, "x": x, "y": y, "current": np.ones(x.size), "voltage": np.full(x.size, 28.8)}
    if with_z:
        columns["z"] = z
    rows = np.stack(list(columns.values()), axis=1)
    file = folder / name
    np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.4f")
    return file


def test_the_ground_is_found_again(tmp_path):
    runs = [drive(tmp_path, "a.csv"), drive(tmp_path, "bb.csv", lanes=(4.0, 5.0, 6.0))]
    found = jm.heightmap_from_runs(runs, antenna_height_m=0.4, crs="EPSG:32615")
    x, y = np.meshgrid(np.arange(1.0, 14.0, 0.5), np.arange(0.5, 6.0, 0.5))
    assert np.abs(found.sample(x, y) - ground(x, y)).max() < 0.04
    assert found.frame.crs == "EPSG:32615"
    assert "a.csv, bb.csv" in found.source
    assert np.isfinite(found.sample(7.0, 7.8))
    assert np.isnan(found.sample(7.0, 8.2))
    # every place on the track sees known ground over the square of 2 m that a network looks at
    corners = [(7.0 + dx, 6.0 + dy) for dx in (-1.0, 1.0) for dy in (-1.0, 1.0)]
    assert all(np.isfinite(found.sample(*corner)) for corner in corners)


def test_runs_in_frames_of_their_own_are_told_apart(tmp_path):
    runs = [drive(tmp_path, "a.csv"), drive(tmp_path, "bb.csv", lift_m=0.3)]
    with pytest.warns(UserWarning, match=r"a\.csv by 0\.3\d? m, bb\.csv by 0\.3\d? m.*one map for each run"):
        jm.heightmap_from_runs(runs)
    code, said, _ = joulemap("heightmap", "--from-runs", *runs, "--each", "--out", tmp_path / "maps")
    assert code == 0
    assert "a.tif" in said
    sites = tomllib.loads((tmp_path / "maps" / "campaign.toml").read_text())["site"]
    assert [site["heightmap"] for site in sites] == ["a.tif", "bb.tif"]
    assert [site["runs"] for site in sites] == [[str(run)] for run in runs]
    lower, upper = (jm.read_heightmap(tmp_path / "maps" / site["heightmap"]).sample(7.0, 1.5) for site in sites)
    assert upper - lower == pytest.approx(0.3, abs=0.02)
    code, _, said = joulemap("heightmap", "--from-runs", *runs, "--each", "--out", tmp_path / "maps")
    assert code == 6
    assert "--overwrite" in said


def test_one_map_of_all_runs_on_the_command_line(tmp_path):
    runs = [drive(tmp_path, "a.csv"), drive(tmp_path, "bb.csv")]
    options = ("--resolution", 0.25, "--crs", "EPSG:32615", "--json", tmp_path / "made.json")
    code, said, warned = joulemap("heightmap", "--from-runs", *runs, "--out", tmp_path / "dem.tif", *options)
    made = json.loads((tmp_path / "made.json").read_text())["maps"]
    assert code == 0
    assert "2 runs" in said
    assert not warned
    assert [one["runs"] for one in made] == [["a.csv", "bb.csv"]]
    assert made[0]["fit_m"] < 0.02
    assert max(made[0]["height_differences_m"].values()) < 0.02
    written = jm.read_heightmap(tmp_path / "dem.tif")
    assert written.resolution_m == 0.25
    assert written.frame.crs == "EPSG:32615"


def test_without_heights_there_is_no_surface(tmp_path):
    flat = drive(tmp_path, "flat.csv", with_z=False)
    with pytest.raises(RunsError, match=r"flat\.csv has no column 'z'.*surveyed"):
        jm.heightmap_from_runs(flat)
    short = drive(tmp_path, "short.csv", lanes=(0.0,))
    lines = short.read_text().splitlines()
    short.write_text("\n".join(lines[:8]) + "\n")
    with pytest.raises(HeightmapError, match=r"no surface through short\.csv: .*at least 12"):
        jm.heightmap_from_runs(short)
