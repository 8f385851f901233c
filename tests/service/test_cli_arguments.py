"""How the command line is read: shared options, several values after one option, limits, and what a user may type."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from joulemap.model.errors import JoulemapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.build import MAX_LATTICE_VALUES
from joulemap.service.cli import app
from joulemap.service.commands.console import RENAMED, Output, one_value_each
from joulemap.service.commands.maps import MOST_VALUES
from joulemap.service.library.heightmaps import read_heightmap
from tests.service import test_cli

READING = {"--resolution", "--west", "--north", "--crs", "--scale", "--offset", "--nodata", "--band"}
GROUP = get_command(app)
COMMANDS = {name: GROUP.get_command(None, name) for name in GROUP.commands}  # type: ignore[attr-defined]


def joulemap(*arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr (without frames) of a command in this process."""
    code, words, errors = test_cli.joulemap(*arguments)
    return code, words, " ".join(errors.replace("│", " ").split())


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated site with three runs, and its heightmap once more as a bare array of centimetres."""
    folder = tmp_path_factory.mktemp("field")
    made = ("simulate", "--out", folder, "--site", "random", "--drive", "waypoints", "--runs", "3", "--seed", "3")
    assert joulemap(*made)[0] == 0
    np.save(folder / "bare.npy", 100.0 * read_heightmap(folder / "dem.tif").heights)
    return folder


@pytest.fixture(scope="module")
def costmap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cost map of 30 x 40 m of gentle waves."""
    folder = tmp_path_factory.mktemp("costmap")
    row, col = np.mgrid[0:30, 0:40]
    heights = (0.3 * np.sin(0.3 * col) + 0.02 * row).astype(np.float32)
    write_geotiff(folder / "dem.tif", Heightmap(heights, GridFrame(0.0, 30.0, 1.0, 30, 40, "EPSG:32630")))
    made = ("costmap", folder / "dem.tif", "--model", "physics", "--out", folder / "dem.zarr")
    assert joulemap(*made)[0] == 0
    return folder / "dem.zarr"


def options_of(name: str) -> set[str]:
    return {option for parameter in COMMANDS[name].params for option in parameter.opts}


def test_every_command_that_reads_a_heightmap_can_be_given_what_the_file_does_not_say() -> None:
    readers = {name for name in COMMANDS if "--heightmap" in options_of(name)} | {"costmap"}
    assert readers >= {"train", "evaluate", "distill", "calibrate", "suggest-drive", "demo"}
    assert {name: READING - options_of(name) for name in readers} == {name: set() for name in readers}


def test_a_bare_array_is_read_as_the_options_say(field: Path) -> None:
    frame = read_heightmap(field / "dem.tif").frame
    place = ("--resolution", frame.resolution_m, "--west", frame.west_m, "--north", frame.north_m, "--scale", "0.01")
    asked = ("evaluate", "--model", "physics", "--robot", field / "robot.toml", "--runs", field, "--json", "-")
    code, words, errors = joulemap(*asked, "--heightmap", field / "bare.npy", *place)
    assert code == 0, errors
    placed = json.loads(joulemap(*asked, "--heightmap", field / "dem.tif")[1])
    assert json.loads(words)["mean_relative_error"] == pytest.approx(placed["mean_relative_error"], rel=1e-3)


@pytest.mark.parametrize("command", ["evaluate", "train", "calibrate", "suggest-drive", "distill"])
def test_a_message_names_the_option_of_the_command(command: str, field: Path, tmp_path: Path) -> None:
    more: dict[str, tuple[object, ...]] = {
        "train": ("--out", tmp_path / "out"),
        "calibrate": ("--out", tmp_path / "out"),
        "distill": ("--out", tmp_path / "out", "--teacher", field),
    }
    asked = (command, "--heightmap", field / "bare.npy", "--runs", field, *more.get(command, ()))
    code, _, errors = joulemap(*asked)
    assert code == 3
    assert "--resolution" in errors
    assert "resolution_m" not in errors


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("--runs a b c --out o", "--runs a --runs b --runs c --out o"),
        ("--runs=a b --out o c", "--runs=a --runs b --out o c"),
        ("--runs a --flag b", "--runs a --flag b"),
        ("--runs a --runs b c", "--runs a --runs b --runs c"),
        ("--stop -1,2 -3.5,4 --out o", "--stop -1,2 --stop -3.5,4 --out o"),
        ("--out --runs x", "--out --runs x"),
        ("--runs a -- b", "--runs a -- b"),
        ("--json - --runs a b", "--json - --runs a --runs b"),
    ],
)
def test_an_option_takes_every_value_up_to_the_next(typed: str, read: str) -> None:
    singles = {"--out", "--json"}
    assert one_value_each(typed.split(), lists={"--runs", "--stop"}, singles=singles) == read.split()


def test_stops_after_one_option_and_a_map_after_them(costmap: Path) -> None:
    pytest.importorskip("ortools")
    stops = ("5.5,5.5", "30.5,8.5", "20.5,25.5")
    code, words, errors = joulemap("tour", "--stop", *stops, costmap, "--json", "-")
    assert code == 0, errors
    repeated = [word for stop in stops for word in ("--stop", stop)]
    assert json.loads(joulemap("tour", costmap, *repeated, "--json", "-")[1]) == json.loads(words)


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_option_of_an_older_version_is_accepted(old: str, new: str, field: Path) -> None:
    users = [name for name in COMMANDS if new in options_of(name)]
    assert users
    for name in users:
        assert old not in options_of(name)  # help has only the name of today
        code, _, errors = joulemap(name, old, field / "nothing.csv", "--help")
        assert (code, f"{old} is now called {new}" in errors) == (0, True)


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("60", "60 is not a share of 0..1: for 60 % write 0.6"),
        ("60%", "for 60 % write 0.6"),
        ("-0.2", "-0.2 is not a share of 0..1"),
        ("half", "'half' is not a number of 0..1"),
        ("nan", "nan is not a share of 0..1"),
    ],
)
@pytest.mark.parametrize("option", ["--charge", "--reserve"])
def test_a_percentage_is_answered_with_the_share_to_type(option: str, typed: str, words: str, costmap: Path) -> None:
    asked = ("feasibility", costmap, "--start", "3.5,4.5", "--goal", "30.5,20.5")
    code, _, errors = joulemap(*asked, option, typed)
    assert code == 2
    assert words in errors
    assert joulemap(*asked, option, "0.6")[0] == 0


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        (["--quantile", "0.8"], 2, "a quantile of 0.8 counts with --objective quantile only"),
        (["--picture", "path.jpg"], 2, "pictures are PNG, and path.jpg does not end in .png"),
        (["--max-power", "25"], 4, "with at most 25 W no way leads from start to goal"),
    ],
)
def test_an_option_that_would_change_nothing_or_cannot_be_met_is_refused(
    more: list[str], code: int, words: str, costmap: Path
) -> None:
    found, _, errors = joulemap("path", costmap, "--start", "3.5,4.5", "--goal", "30.5,20.5", *more)
    assert words in errors
    assert found == code


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            ["feasibility", "MAP", "--path", "FILE", "--objective", "arrival"],
            "--objective and --max-power choose a path",
        ),
        (["feasibility", "MAP", "--path", "FILE", "--max-power", "300"], "--objective and --max-power choose a path"),
        (["feasibility", "MAP", "--start", "3.5,4.5"], "give either --path, or --start and --goal"),
        (["calibrate", "--runs", "FILE", "--site", "a.tif=a.csv", "--out", "made"], "give one of --runs"),
        (["demo", "--start", "3.5,4.5"], "give both --start and --goal"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(
    more: list[str], words: str, costmap: Path, tmp_path: Path
) -> None:
    path = tmp_path / "path.csv"
    path.write_text("x,y\n3.5,4.5\n30.5,20.5\n")
    code, _, errors = joulemap(*({"MAP": costmap, "FILE": path}.get(word, word) for word in more))
    assert (code, words in " ".join(errors.replace("│", " ").split())) == (2, True), errors


def test_evaluate_says_what_it_took_for_energy_and_which_runs_are_not_on_the_map(field: Path, tmp_path: Path) -> None:
    for name, shift in (("near.csv", 0.0), ("far.csv", 9000.0)):
        header, *rows = csv.reader(next(field.glob("**/*.csv")).read_text().splitlines())
        kept = [k for k, column in enumerate(header) if column in ("t", "x", "y", "current")]
        x = [header[k] for k in kept].index("x")
        lines = [[row[k] for k in kept] for row in rows]
        lines = [[*line[:x], str(float(line[x]) + shift), *line[x + 1 :]] for line in lines]
        (tmp_path / name).write_text("\n".join(",".join(line) for line in [[header[k] for k in kept], *lines]))
    code, words, errors = joulemap(
        "evaluate",
        "--heightmap",
        field / "dem.tif",
        "--model",
        "physics",
        "--runs",
        tmp_path / "near.csv",
        tmp_path / "far.csv",
    )
    assert code == 0, errors
    assert "Model physics on 1 run" in words
    assert "energy is the logged charge times the robot's nominal voltage, 28.8 V, and not measured" in errors
    assert "no metre of these runs lies on known ground of the map: far.csv" in errors


def test_a_file_is_no_folder_to_write_to(costmap: Path, field: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken.csv"
    taken.write_text("mine")
    run = next(field.glob("**/*.csv"))
    assert "is a file: give a folder for the CSV files" in joulemap("import", run, "--out", taken)[2]
    made = joulemap("costmap", costmap.parent / "dem.tif", "--model", "physics", "--out", taken)
    assert "is a file: give another name" in made[2]
    assert taken.read_text() == "mine"


def test_a_cost_map_too_large_is_refused_at_once(costmap: Path, tmp_path: Path) -> None:
    assert MOST_VALUES == MAX_LATTICE_VALUES  # what `joulemap path` can hold in memory
    dem, out = costmap.with_name("dem.tif"), tmp_path / "fine.zarr"
    asked = ("costmap", dem, "--model", "physics", "--out", out, "--spacing")
    code, words, errors = joulemap(*asked, "0.01", "--headings", "36")
    assert (code, words) == (7, "")
    assert "3,000 x 4,000 cells of 0.01 m with 36 headings: 432,000,000 values, up to 3.5 GB on disk" in errors
    assert "The limit is 400,000,000" in errors
    assert "--max-values 432000000" in errors
    code, _, errors = joulemap(*asked, "0.5", "--max-values", "1000")
    assert (code, "coarser --spacing" in errors) == (7, True)
    assert list(tmp_path.iterdir()) == []
    assert joulemap(*asked, "0.5", "--max-values", str(60 * 80 * 16))[0] == 0


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_command_that_is_stopped_leaves_nothing_behind(costmap: Path, tmp_path: Path, number: int, code: int) -> None:
    """The size is said before the work begins; then the command is stopped in the middle of it."""
    command = [sys.executable, "-m", "joulemap.service.cli", "costmap", str(costmap.with_name("dem.tif"))]
    command += ["--model", "physics", "--spacing", "0.02", "--out", str(tmp_path / "fine.zarr")]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    deadline = time.monotonic() + 120.0
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(number)
    said, errors = process.communicate(timeout=60)
    assert process.returncode == code, errors
    assert "1,500 x 2,000 cells of 0.02 m with 16 headings: 48,000,000 values, up to 0.4 GB on disk" in said
    if number == signal.SIGINT:
        assert errors.splitlines()[-1] == "stopped: nothing is left behind"
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def _tour(costmap: Path, folder: Path) -> dict[str, object]:
    pytest.importorskip("ortools")
    asked = ("tour", costmap, "--stop", "5.5,5.5", "30.5,8.5", "20.5,25.5", "--geojson", folder / "tour.geojson")
    code, words, errors = joulemap(*asked, "--json", "-")
    assert code == 0, errors
    (folder / "tour.json").write_text(words)
    legs = [leg["path"] for leg in json.loads(words)["legs"]]
    (folder / "legs.json").write_text(json.dumps({"legs": [{"path": leg} for leg in legs]}))
    (folder / "lines.geojson").write_text(json.dumps({"type": "MultiLineString", "coordinates": legs}))
    return json.loads(words)


@pytest.mark.parametrize("name", ["tour.geojson", "tour.json", "legs.json", "lines.geojson"])
def test_all_legs_of_a_tour_are_judged(name: str, costmap: Path, tmp_path: Path) -> None:
    whole = _tour(costmap, tmp_path)
    code, words, errors = joulemap("feasibility", costmap, "--path", tmp_path / name, "--json", "-")
    assert code == 0, errors
    assert json.loads(words)["energy_j"] == pytest.approx(whole["energy_j"], rel=1e-5)


def test_lines_that_do_not_touch_are_no_path(costmap: Path, tmp_path: Path) -> None:
    lines = [[[5.5, 5.5], [10.5, 5.5]], [[10.5, 7.5], [20.5, 9.5]]]
    (tmp_path / "two.geojson").write_text(json.dumps({"type": "MultiLineString", "coordinates": lines}))
    code, _, errors = joulemap("feasibility", costmap, "--path", tmp_path / "two.geojson")
    assert code == 3
    assert "line 1 ends at (10.50, 5.50), but line 2 begins at (10.50, 7.50), 2.00 m away" in errors


def test_of_the_lines_of_a_path_the_energy_optimal_one_is_judged(costmap: Path, tmp_path: Path) -> None:
    asked = ("path", costmap, "--start", "3.5,4.5", "--goal", "36.5,22.5", "--alternatives", "2")
    code, words, errors = joulemap(*asked, "--geojson", tmp_path / "path.geojson", "--json", "-")
    assert code == 0, errors
    _, judged, _ = joulemap("feasibility", costmap, "--path", tmp_path / "path.geojson", "--json", "-")
    assert json.loads(judged)["energy_j"] == pytest.approx(json.loads(words)["energy_j"], rel=1e-6)


def test_the_bound_is_said_where_it_is_asked_for(costmap: Path) -> None:
    asked = ("path", costmap, "--start", "3.5,4.5", "--goal", "36.5,22.5")
    assert "lower bound" not in joulemap(*asked)[1]
    code, words, errors = joulemap(*asked, "--bound")
    assert code == 0, errors
    assert re.search(r"lower bound +[\d.]+ k?J .*: no path takes less by more than [\d.]+ %", words), words


def test_snap_takes_the_nearest_free_place(tmp_path: Path) -> None:
    heights = np.zeros((20, 30), dtype=np.float32)
    heights[8:12, 10:20] = np.nan
    write_geotiff(tmp_path / "dem.tif", Heightmap(heights, GridFrame(0.0, 20.0, 1.0, 20, 30)))
    out = tmp_path / "dem.zarr"
    assert joulemap("costmap", tmp_path / "dem.tif", "--model", "physics", "--out", out)[0] == 0
    ends = ("--start", "13.5,11.4", "--goal", "25.5,3.5")  # the start is in the hole
    near = ("--start", "13.5,12.4", *ends[2:])  # one cell from where the robot fits
    tasks = {"path": ends, "feasibility": near, "tour": ("--stop", "13.5,11.4", "25.5,3.5", "3.5,3.5")}
    for command, task in tasks.items():
        if command == "tour":
            pytest.importorskip("ortools")
        code, _, errors = joulemap(command, out, *task)
        assert code == 4
        assert "the nearest free place is (" in errors
        assert errors.endswith("; --snap goes there")
        code, words, errors = joulemap(command, out, *task, "--snap", "--json", "-")
        assert code == 0, errors
        assert "moved to the nearest free place" in errors
        found = json.loads(words)
        x, y, _ = (found["out"] if command == "feasibility" else found)["path"][0]
        assert 12.0 <= y < 14.0
        assert abs(x - 13.5) <= 1.0
    code, _, errors = joulemap("feasibility", out, *ends, "--snap")  # a verdict is about the place that was asked for
    assert code == 4
    assert errors.endswith("--snap may move it by 1.41 m at most")


def test_a_number_that_is_not_finite_is_named_and_never_written(tmp_path: Path) -> None:
    document = {"type": "Feature", "geometry": {"coordinates": [[1.0, 2.0, 3.0], [1.0, 2.0, float("nan")]]}}
    with pytest.raises(JoulemapError, match=r"geometry\.coordinates\[1\]\[2\] is not a finite number"):
        Output(tmp_path / "answer.json").document(document)
    assert list(tmp_path.iterdir()) == []
