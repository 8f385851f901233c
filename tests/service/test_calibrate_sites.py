"""Calibration of runs on several maps in one call: `--site`, a campaign file, and Python."""

import json
import math
import shlex

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import read_calibration_runs
from joulemap.model.runs.sites import Site, with_test_files
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.loop.measured import measure
from joulemap.service.models import load_model
from tests.service.test_cli import joulemap

ROBOT = Robot(mass_kg=40.0, speed_mps=0.5, idle_power_w=10.0, rolling_resistance=0.08)
TURNING_J = 60.0  # per radian, beside what the robot file says
SIDE_M = 30.0
VOLTS = 24.0


def log(number, *, turning=TURNING_J, metres=70.0):
    """A run between random places of a level square, steered there in waves; speed and power vary."""
    rng, dt = np.random.default_rng(number), 0.1
    x = y = SIDE_M / 2.0
    heading, rows = 0.0, ["t,x,y,voltage,current"]
    aim = rng.uniform(4.0, SIDE_M - 4.0, 2)
    per_m = ROBOT.weight_n * ROBOT.rolling_resistance
    for k in range(int(metres / (ROBOT.speed_mps * dt))):
        if math.hypot(aim[0] - x, aim[1] - y) < 1.5:
            aim = rng.uniform(4.0, SIDE_M - 4.0, 2)
        away = (math.atan2(aim[1] - y, aim[0] - x) - heading + math.pi) % (2.0 * math.pi) - math.pi
        rate = 0.4 * math.tanh(2.0 * away) + 0.25 * math.sin(0.7 * k * dt + number)
        speed = ROBOT.speed_mps * (1.0 + 0.1 * math.sin(0.1 * k * dt + number))
        power = ROBOT.idle_power_w + speed * per_m + turning * abs(rate) + rng.normal(0.0, 20.0)
        rows.append(f"{dt * k:.2f},{x:.4f},{y:.4f},{VOLTS},{power / VOLTS:.5f}")
        heading += rate * dt
        x += speed * dt * math.cos(heading)
        y += speed * dt * math.sin(heading)
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Two copies of a map, two runs on each of which those on `b` are longer, two baseline runs, the robot."""
    folder = tmp_path_factory.mktemp("field")
    for place in ("a", "b"):
        cells = int(SIDE_M)
        ground = Heightmap(np.zeros((cells, cells), dtype=np.float32), GridFrame(0.0, SIDE_M, 1.0, cells, cells))
        write_geotiff(folder / f"{place}.tif", ground)
        (folder / place).mkdir()
        for k in (1, 2):
            (folder / place / f"{place}{k}.csv").write_text(log(ord(place) + k, metres=70.0 if place == "a" else 90.0))
    (folder / "before").mkdir()
    for k in (1, 2):
        (folder / "before" / f"before{k}.csv").write_text(log(k))
    (folder / "robot.toml").write_text(
        "".join(f"{key} = {json.dumps(value)}\n" for key, value in ROBOT.as_dict().items())
    )
    return folder


def pairs(field):
    return [(field / f"{place}.tif", field / place) for place in ("a", "b")]


def sites(field):
    return [word for ground, runs in pairs(field) for word in ("--site", f"{ground}={runs}/*.csv")]


def calibrate(field, out, *words, robot=True):
    given = ["--robot", field / "robot.toml"] if robot else []
    return joulemap("calibrate", "--model", "physics", *given, "--quick", "--out", out, *words)


def report_of(out):
    return json.loads((out / "report.json").read_text())


FITTED = ("effects", "base_parameters", "variation", "error", "candidates", "segments", "ranges", "confounded")


@pytest.fixture(scope="module")
def found(field, tmp_path_factory):
    """Folder and answer of a calibration with both maps."""
    out = tmp_path_factory.mktemp("found")
    code, said, _ = calibrate(field, out, *sites(field))
    assert code == 0
    return out, said


def test_runs_of_two_maps_are_one_calibration(field, found, tmp_path):
    """The maps are copies of one: the calibration of all runs on that one is the same."""
    out, said = found
    report = report_of(out)
    assert report["effects"][0]["name"] == "turning"
    assert report["turning_in_plans"]["j_per_rad"] == pytest.approx(TURNING_J, rel=0.1)
    calibrate(field, tmp_path / "one", "--heightmap", field / "a.tif", "--runs", field / "a", field / "b")
    alone = report_of(tmp_path / "one")
    assert {key: report[key] for key in FITTED} == {key: alone[key] for key in FITTED}
    assert [(site["heightmap"], site["runs"], site["main"]) for site in report["sites"]] == [
        ("a.tif", ["a1.csv", "a2.csv"], False),
        ("b.tif", ["b1.csv", "b2.csv"], True),
    ]
    assert sum(site["used_m"] for site in report["sites"]) == pytest.approx(alone["sites"][0]["used_m"])
    assert report["sites"][1]["used_m"] > report["sites"][0]["used_m"] > 100.0
    words = "Of 2 maps, the most metres were driven on b.tif (run b1.csv)"
    assert words in said
    assert words in (out / "report.html").read_text()
    assert "Of 2 maps" not in (tmp_path / "one" / "report.html").read_text()
    step = next(line.strip() for line in said.splitlines() if line.strip().startswith("joulemap costmap"))
    assert shlex.split(step)[2] == str(field / "b.tif")
    made = jm.calibrate(sites=pairs(field), robot=ROBOT, model="physics", quick=True, out=tmp_path / "python")
    assert made.report["effects"] == report["effects"]
    assert words in str(made)


def test_a_drive_is_suggested_by_the_printed_command(found, tmp_path):
    step = next(line.strip() for line in found[1].splitlines() if line.strip().startswith("joulemap suggest-drive"))
    code, said, _ = joulemap(*shlex.split(step)[1:], "--length", 60, "--json", tmp_path / "drive.json")
    assert code == 0
    assert said.startswith("Drive ")
    for x, y in json.loads((tmp_path / "drive.json").read_text())["points"]:
        assert 0.0 < x < SIDE_M
        assert 0.0 < y < SIDE_M


def campaign(field, name, text):
    file = field / name
    file.write_text(text)
    return file


def test_baseline_runs_of_a_campaign_file_lie_on_a_map_of_their_own(field, tmp_path):
    """Turning was as dear before: nothing is new. Without the baseline it is found."""
    new = "".join(f'[[site]]\nheightmap = "{place}.tif"\nruns = "{place}/*.csv"\n' for place in ("a", "b"))
    before = '[[site]]\nheightmap = "a.tif"\nbaseline = ["before/before1.csv"]\n'
    beside = 'baseline = "before/before2.csv"\n'
    file = campaign(field, "all.toml", f'robot = "robot.toml"\n{before}{new}{beside}')
    code, said, _ = calibrate(field, tmp_path / "campaign", "--campaign", file, robot=False)
    assert code == 0
    report = report_of(tmp_path / "campaign")
    assert report["baseline_runs"]
    assert "turning" not in [e["name"] for e in report["effects"]]
    assert [site["baseline_runs"] for site in report["sites"]] == [["before1.csv"], [], ["before2.csv"]]
    assert "--robot ROBOT" in said
    assert str(field / "b.tif") in said
    with pytest.raises(InputError, match=r"the site a\.tif has no `runs` to learn from"):
        jm.evaluate(campaign=file)


def test_robots_that_differ_are_refused(field, tmp_path):
    sites = "".join(
        f'[[site]]\nheightmap = "{place}.tif"\nruns = "{place}/*.csv"\nrobot = {{ name = "{name}" }}\n'
        for place, name in (("a", "mule"), ("b", "hinny"))
    )
    code, _, error = calibrate(field, tmp_path, "--campaign", campaign(field, "two.toml", sites), robot=False)
    assert code == 3
    words = " ".join(error.split())
    assert "the robot of the site b.tif (hinny) is not declared like that of the site a.tif (mule)" in words
    assert not (tmp_path / "model").exists()


def test_test_runs_are_taken_from_their_site(field, tmp_path):
    code, said, _ = calibrate(
        field, tmp_path, *sites(field), "--test-runs", field / "a" / "a1.csv", field / "b" / "b2.csv"
    )
    assert code == 0
    report = report_of(tmp_path)
    assert report["runs"]["names"] == ["a2.csv", "b1.csv"]
    assert set(report["test_set"]["error"]["after"]["by_run"]) == {"a1.csv", "b2.csv"}
    assert [site["test_runs"] for site in report["sites"]] == [["a1.csv"], ["b2.csv"]]
    assert report["test_set"]["error"]["after"]["rmse"] < 0.5 * report["test_set"]["error"]["before"]["rmse"]
    assert "4 runs, " in said


def test_a_whole_map_may_be_for_the_test_and_a_test_run_without_a_map_is_refused(field):
    files = [tuple(sorted(runs.glob("*.csv"))) for _, runs in pairs(field)]
    given = [Site(ground, some, ROBOT) for ground, some in zip(grounds(), files, strict=True)]
    here = with_test_files(given, given[1].files)
    read = read_calibration_runs(here)
    assert read.sites[1].new is None
    found = measure("physics", load_model("physics"), read)
    assert found.main is read.sites[0]
    assert found.driven_m[1] == 0.0
    assert set(found.test.runs) == {"b1.csv", "b2.csv"}
    with pytest.raises(RunsError, match="there is no run to read"):
        read_calibration_runs(with_test_files(given, [file for site in given for file in site.files]))
    stray = field / "before" / "before1.csv"
    with pytest.raises(InputError, match=r"before1\.csv is on no site"):
        with_test_files(given, [stray])
    assert with_test_files(given[:1], [stray])[0].test_files == (stray,)  # of a single map, it can be on no other
    both = Site(given[0].heightmap, given[0].files, ROBOT, baseline_files=(stray,))
    assert with_test_files([both], [stray])[0].baseline_files == ()


def grounds():
    frame = GridFrame(0.0, SIDE_M, 1.0, int(SIDE_M), int(SIDE_M))
    return [Heightmap(np.zeros((frame.rows, frame.cols), dtype=np.float32), frame, source=f"{p}.tif") for p in "ab"]


def test_the_least_number_of_segments_is_asked_of_all_sites_together(tmp_path):
    def _read(metres):
        files = [tmp_path / f"{name}.csv" for name in "ab"]
        for k, file in enumerate(files):
            file.write_text(log(k, metres=metres))
        given = [Site(ground, (file,), ROBOT) for ground, file in zip(grounds(), files, strict=True)]
        return measure("physics", load_model("physics"), read_calibration_runs(given))

    assert len(_read(14.0).residuals) > 20
    with pytest.raises(RunsError, match=r"only \d+ of \d+ segments of 1 m .*heightmaps know; at least 20 are needed"):
        _read(8.0)


def test_a_run_beside_its_map_names_the_site(field):
    away = Heightmap(grounds()[1].heights, GridFrame(500.0, SIDE_M, 1.0, 30, 30), source="far.tif")
    files = [tuple(sorted(runs.glob("*.csv"))) for _, runs in pairs(field)]
    read = read_calibration_runs([Site(grounds()[0], files[0], ROBOT), Site(away, files[1], ROBOT)])
    with pytest.raises(RunsError, match=r"the runs lie off the heightmap.*\(site far\.tif\)"):
        measure("physics", load_model("physics"), read)


def test_ways_to_name_runs_do_not_mix(field, tmp_path):
    for words in (
        [*sites(field), "--heightmap", field / "a.tif"],
        [*sites(field), "--odometry", 1.0],
        [*sites(field), "--runs", field / "a"],
        [*sites(field), "--baseline-runs", field / "before"],
        ["--odometry", 1.0],
    ):
        assert calibrate(field, tmp_path, *words)[0] == 2
    with pytest.raises(InputError, match="`baseline_runs` go with `runs`"):
        jm.calibrate(sites=pairs(field), baseline_runs=field / "before", robot=ROBOT, out=tmp_path)
    with pytest.raises(InputError, match=r"a1\.csv is given twice"):
        jm.calibrate(sites=[pairs(field)[0]] * 2, robot=ROBOT, out=tmp_path)
