"""The command line: the same answers as the parts it calls, plain errors, and exit codes from the table."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.cli import app
from joulemap.service.commands.console import parse_point
from joulemap.service.words import duration_words, energy_words, saving_words
from tests.reference.lattices import price_world_path

WEIGHTS = Path(__file__).resolve().parents[2] / "model" / "weights"
PNG = b"\x89PNG\r\n\x1a\n"


def joulemap(*arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command in this process."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hill, a hole and a wall in dem.tif, and the cost map made of it in dem.zarr."""
    folder = tmp_path_factory.mktemp("cli")
    row, col = np.mgrid[0:30, 0:40]
    heights = 2.5 * np.exp(-((row - 15.0) ** 2 + (col - 20.0) ** 2) / 50.0)
    heights[24:27, 33:37] = np.nan
    heights[2:5, 8:14] += 2.0
    frame = GridFrame(0.0, 30.0, 1.0, 30, 40, "EPSG:32630")
    write_geotiff(folder / "dem.tif", Heightmap(heights.astype(np.float32), frame))
    (folder / "robot.toml").write_text('name = "crawler"\nmass_kg = 50\nidle_power_w = 20\n')
    asked = (
        f"costmap {folder}/dem.tif --robot {folder}/robot.toml --model physics --out {folder}/dem.zarr "
        f"--geotiff {folder}/dem_energy.tif --npz {folder}/dem.npz --picture {folder}/dem.png --json "
        f"{folder}/dem.json"
    )
    code, _, errors = joulemap(*asked.split())
    assert code == 0, errors
    return folder


def test_help_answers_without_the_heavy_parts() -> None:
    script = "import sys, joulemap.service.cli; print(*sorted(set(sys.modules) & set(sys.argv[1:])))"
    heavy = ["torch", "numba", "numpy", "matplotlib", "fastapi", "ompl", "sqlalchemy", "zarr"]
    done = subprocess.run([sys.executable, "-c", script, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("given", [None, "1"])
def test_commands_ask_for_no_large_pages_unless_it_is_wished(given: str | None) -> None:
    script = (
        "from joulemap.service.cli import app; app(['path', '--help'], standalone_mode=False); "
        "from numpy._core import multiarray; print(multiarray._get_madvise_hugepage())"
    )
    around = {name: value for name, value in os.environ.items() if name != "NUMPY_MADVISE_HUGEPAGE"}
    around |= {} if given is None else {"NUMPY_MADVISE_HUGEPAGE": given}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=around)
    assert done.stdout.split()[-1] == str(given == "1")


def test_costmap_writes_what_it_says(folder: Path) -> None:
    lattice = load_lattice(folder / "dem.zarr")
    said = json.loads((folder / "dem.json").read_text())
    assert lattice.robot == Robot(name="crawler", mass_kg=50.0, idle_power_w=20.0)
    assert (said["rows"], said["cols"], said["headings"]) == (30, 40, 16)
    assert said["robot"]["mass_kg"] == 50.0
    assert said["blocked"] == pytest.approx(lattice.blocked_shares())
    assert 0.0 < said["blocked"]["unknown"] < 0.1
    assert (folder / "dem_energy.tif").read_bytes()[:4] in (b"II*\0", b"MM\0*")
    assert np.load(folder / "dem.npz")["energy_per_m"].shape == (30, 40, 16)
    assert (folder / "dem.png").read_bytes().startswith(PNG)


def test_path_is_the_planner_s(folder: Path) -> None:
    asked = (
        f"path {folder}/dem.zarr --start 3.5,14.5 --goal 36.5,15.5 --geojson {folder}/path.geojson "
        f"--picture {folder}/path.png --json {folder}/path.json"
    )
    code, words, errors = joulemap(*asked.split())
    assert (code, errors) == (0, "")
    lattice = load_lattice(folder / "dem.zarr")
    plan = RoutePlanner(lattice).plan((3.5, 14.5), (36.5, 15.5))
    said = json.loads((folder / "path.json").read_text())
    assert said["energy_j"] == pytest.approx(plan.route.energy_j, rel=1e-12)
    assert said["shortest"]["length_m"] == pytest.approx(plan.shortest.length_m, rel=1e-12)
    assert price_world_path(lattice, said["path"]) == pytest.approx(said["energy_j"], rel=1e-6)
    assert "crawler" in words
    assert f"{said['length_m']:.1f} m" in words
    lines = json.loads((folder / "path.geojson").read_text())["features"]
    assert [line["geometry"]["type"] for line in lines] == ["LineString", "LineString"]
    assert (folder / "path.png").read_bytes().startswith(PNG)


def test_json_to_stdout_leaves_nothing_else_there(folder: Path) -> None:
    asked = (
        f"path {folder}/dem.zarr --start 3.5,14.5 --goal 36.5,15.5 --neighbours 8 --no-refine --planner "
        f"dijkstra --json -"
    )
    code, words, errors = joulemap(*asked.split())
    assert code == 0
    assert json.loads(words)["planner"] == "dijkstra"
    assert "energy-optimal" in errors


@pytest.mark.parametrize("kind", ["geojson", "json", "csv"])
def test_a_path_s_file_is_judged_at_its_own_price(folder: Path, kind: str) -> None:
    asked = (
        f"path {folder}/dem.zarr --start 3.5,14.5 --goal 36.5,15.5 --geojson {folder}/way.geojson --json "
        f"{folder}/way.json"
    )
    joulemap(*asked.split())
    path = json.loads((folder / "way.json").read_text())
    (folder / "way.csv").write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y, _ in path["path"]))
    code, words, _ = joulemap("feasibility", folder / "dem.zarr", "--path", folder / f"way.{kind}", "--json", "-")
    assert code == 0
    # places in degrees are rounded, by about a millimetre
    assert json.loads(words)["energy_j"] == pytest.approx(path["energy_j"], rel=1e-5 if kind == "geojson" else 1e-6)


def test_a_battery_that_does_not_last_is_an_answer(folder: Path) -> None:
    task = ("feasibility", folder / "dem.zarr", "--start", "3.5,14.5", "--goal", "36.5,15.5", "--round-trip")
    code, words, _ = joulemap(*task, "--capacity-wh", "1", "--charge", "0.5", "--reserve", "0.1", "--json", "-")
    verdict = json.loads(words)
    assert code == 0
    assert not verdict["feasible"]
    assert verdict["available_j"] == pytest.approx(0.4 * 3600.0)
    assert verdict["shortfall_j"] == pytest.approx(verdict["energy_j"] - 0.4 * 3600.0)
    assert verdict["energy_j"] == pytest.approx(verdict["out"]["energy_j"] + verdict["back"]["energy_j"])
    code, words, _ = joulemap(*task)
    assert code == 0
    assert words.startswith("feasible")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("costmap", "{}/nothing.tif", "--out", "{}/x.zarr"), 5, "no file"),
        (("costmap", "{}/robot.toml", "--out", "{}/x.zarr"), 3, "not a heightmap"),
        (("costmap", "{}/dem.tif", "--robot", "{}/dem.json", "--out", "{}/x.zarr"), 3, "robot file"),
        (("costmap", "{}/dem.tif", "--model", "nonsense", "--out", "{}/x.zarr"), 5, "nonsense"),
        (("costmap", "{}/dem.tif", "--spacing", "1000", "--out", "{}/x.zarr"), 3, "too small"),
        (("costmap", "{}/dem.tif", "--model", "physics", "--out", "{}/dem.zarr"), 6, "dem.zarr is there already"),
        (("costmap", "{}/dem.tif", "--out", "{}/robot.toml", "--overwrite"), 3, "not be overwritten"),
        (("path", "{}", "--start", "1,1", "--goal", "2,2"), 3, "not a cost lattice"),
        (("path", "{}/dem.zarr", "--start", "3.5,14.5", "--goal", "400,4"), 3, "outside the map"),
        (("path", "{}/dem.zarr", "--start", "nan,2", "--goal", "4,4"), 2, "finite"),
        (("path", "{}/dem.zarr", "--start", "35.5,5.5", "--goal", "4.5,14.5"), 4, "blocked ground: unknown"),
        (("path", "{}/dem.zarr", "--start", "3.5,14.5", "--goal", "9.5,15.5", "--planner", "ant"), 3, "ant"),
        (("path", "{}/dem.zarr", "--start", "3.5;14.5", "--goal", "4,4"), 2, "X,Y"),
        (("feasibility", "{}/dem.zarr", "--path", "{}/robot.toml"), 3, "no path"),
        (("feasibility", "{}/dem.zarr", "--path", "{}/nothing.csv"), 5, "nothing.csv"),
        (("feasibility", "{}/dem.zarr", "--start", "3.5,14.5"), 2, "start"),
        (("evaluate", "--model", "physics", "--heightmap", "{}/dem.tif", "--runs", "{}/*.log"), 5, "names no log"),
        (("train", "--out", "{}/m", "--heightmap", "{}/dem.tif"), 2, "go together"),
        (("train", "--out", "{}/m", "--charge", "--epochs", "3"), 2, "--charge, --epochs: only with"),
    ],
)
def test_an_error_is_one_line_and_a_code(folder: Path, arguments: tuple[str, ...], code: int, words: str) -> None:
    got, out, errors = joulemap(*(a.replace("{}", str(folder)) for a in arguments))
    assert got == code, errors
    assert out == ""
    assert words in errors.replace("\n", " ").replace("│", " ")
    assert "Traceback" not in errors
    if code != 2:  # wrong usage is told by typer, with a hint
        assert errors.startswith("error: ")
        assert len(errors.splitlines()) == 1


def test_wrong_settings_of_a_service_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    code, _, said = joulemap("serve", "--data-dir", tmp_path / "file" / "data")
    assert (code, "error:" in said, str(tmp_path / "file") in said) == (1, True, True)
    for name, value in (("MAX_RUNS", "many"), ("WARM_MODELS", "default"), ("DATA_DIR", "s3://bucket/data")):
        with monkeypatch.context() as environment:
            environment.setenv(f"JOULEMAP_{name}", value)
            code, _, said = joulemap("serve")
        assert code == 2
        assert name.lower() in said.lower()


def test_a_warning_is_seen_and_kept(tmp_path: Path) -> None:
    """Cells longer than the 1 m segment hide the pitch that the physics needs."""
    flat = Heightmap(np.zeros((12, 12), dtype=np.float32), GridFrame(0.0, 24.0, 2.0, 12, 12))
    write_geotiff(tmp_path / "coarse.tif", flat)
    code, words, errors = joulemap(
        "costmap", tmp_path / "coarse.tif", "--model", "physics", "--out", tmp_path / "c.zarr", "--json", "-"
    )
    assert code == 0
    assert "warning: " in errors
    assert json.loads(words)["warnings"] == load_lattice(tmp_path / "c.zarr").provenance["warnings"] != []


def test_warnings_name_options_and_names_may_hold_brackets(tmp_path: Path) -> None:
    heights = np.random.default_rng(1).uniform(0, 2000, (30, 30)).round()
    dem = tmp_path / "[red]dem[1].tif"
    write_geotiff(dem, Heightmap(heights.astype(np.float32), GridFrame(0.0, 30.0, 1.0, 30, 30, "EPSG:32630")))
    (tmp_path / "robot.toml").write_text('name = "rover [/x] [bold]2"\n')
    made = ("--robot", tmp_path / "robot.toml", "--model", "physics", "--out", tmp_path / "[blue]c.zarr")
    code, words, errors = joulemap("costmap", dem, *made)
    assert code == 0
    assert "in centimetres: then --scale is 0.01?" in errors
    assert words.startswith("Cost map of [red]dem[1].tif for rover [/x] [bold]2, model physics\n")
    assert f"written  {tmp_path}/[blue]c.zarr\n" in words


def test_a_heightmap_without_a_place_is_given_one(tmp_path: Path) -> None:
    np.save(tmp_path / "bare.npy", np.zeros((20, 30), dtype=np.float32))
    bare = ("costmap", tmp_path / "bare.npy", "--model", "physics", "--out", tmp_path / "bare.zarr")
    code, _, errors = joulemap(*bare)
    assert code == 3
    assert "give --resolution, the side of a cell" in errors
    place = ("--resolution", "0.5", "--west", "100", "--north", "70", "--crs", "EPSG:32630")
    assert joulemap(*bare, *place)[0] == 0
    frame = load_lattice(tmp_path / "bare.zarr").frame
    assert frame.bounds == (100.0, 60.0, 115.0, 70.0)
    assert frame.crs == "EPSG:32630"
    assert joulemap(*bare, "--resolution", "1", "--overwrite")[0] == 0
    assert load_lattice(tmp_path / "bare.zarr").frame.bounds == (0.0, 0.0, 30.0, 20.0)


def test_simulated_runs_are_judged_and_learned_from(tmp_path: Path) -> None:
    field, model = tmp_path / "field", tmp_path / "model"
    made = ("simulate", "--out", field, "--site", "random", "--drive", "waypoints", "--runs", "2", "--seed", "3")
    assert joulemap(*made)[0] == 0
    assert sorted(p.name for p in field.iterdir()) == ["dem.tif", "robot.toml", "run_01.csv", "run_02.csv"]
    declared = Robot.from_toml(field / "robot.toml")
    assert replace(declared, rolling_resistance=Robot().rolling_resistance) == Robot()
    measured = ("--heightmap", field / "dem.tif", "--robot", field / "robot.toml", "--runs", field)
    code, words, errors = joulemap("evaluate", "--model", "physics", *measured, "--json", "-")
    assert code == 0, errors
    physics = json.loads(words)
    assert physics["segments"] > 100
    assert physics["mean_relative_error"] < 0.4  # the owner's rolling resistance is not far off
    assert set(physics["route_relative_errors"]) == {"run_01.csv", "run_02.csv"}
    tune = ("--epochs", "2")  # the compact network starts from the shipped one
    code, words, errors = joulemap("train", *measured, *tune, "--out", model, "--json", "-")
    assert code == 0, errors
    trained = json.loads(words)
    again = ("train", *measured, "--epochs", "1", "--seed", "1", "--out", model)
    code, _, errors = joulemap(*again)
    assert (code, f"{model} is there already" in errors) == (6, True)
    assert (trained["epochs"], len(trained["held_out_runs"])) == (2, 2)  # each by a network without it
    shipped, mine = (json.loads((f / "config.json").read_text())["domain"]["robot"] for f in (WEIGHTS, model))
    assert all(mine[key][0] <= low and mine[key][1] >= high for key, (low, high) in shipped.items())
    code, words, errors = joulemap("evaluate", "--model", model, *measured, "--json", "-")
    assert code == 0, errors
    error = json.loads(words)["route_relative_errors"][trained["held_out_runs"][0]]
    assert "warning: " in errors  # it was trained on these runs
    assert error == pytest.approx(trained["held_out"]["route_relative_error"], abs=0.05)  # turns are judged here too


def test_the_installed_command(folder: Path) -> None:
    command = Path(sys.executable).with_name("joulemap")
    where = [folder / "dem.zarr", "--start", "35.5,5.5", "--goal", "4.5,14.5"]
    done = subprocess.run([command, "path", *map(str, where)], capture_output=True, text=True)
    assert done.returncode == 4
    assert done.stderr.startswith("error: start (35.50, 5.50) is on blocked ground")
    assert done.stdout == ""


def test_numbers_in_words() -> None:
    assert energy_words(950.0) == "950 J"
    assert energy_words(36_000.0) == "36.00 kJ (10.00 Wh)"
    assert duration_words(59.6) == "1 min 00 s"
    assert duration_words(7260.0) == "2 h 01 min"
    assert parse_point("-3.5, 1e3") == (-3.5, 1000.0)
    same = {"energy_j": 100.0, "length_m": 10.0}
    assert saving_words(same, same).startswith("nothing")
    assert saving_words({"energy_j": 750.0, "length_m": 12.0}, {"energy_j": 1000.0, "length_m": 10.0}) == (
        "250 J less than the shortest (25.0%), 2.0 m longer"
    )
