"""Runs on several maps in one call: pairs in Python, `--site`, a campaign file; real drives, each on its own map."""

import json
import os
from pathlib import Path

import pytest

import joulemap as jm
from joulemap.model.energy.artifact import read_artifact
from joulemap.model.errors import InputError, NotFoundError
from joulemap.model.robot import Robot
from joulemap.model.terrain.writers import write_geotiff
from joulemap.model.training.measured_runs import _warnings
from joulemap.service.library.sites import read_campaign, sites_of_options
from tests.service.test_cli import joulemap
from tests.service.test_learning import ROBOT, drive, waves

REAL = Path(os.environ.get("JOULEMAP_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))
WARTHOG = Robot(
    name="warthog",
    mass_kg=470.0,
    width_m=1.5,
    length_m=1.5,
    wheel_radius_m=0.3,
    nominal_voltage_v=48.0,
    speed_mps=1.2,
    idle_power_w=0.0,  # the logged power is that of the motors
    rolling_resistance=0.05,
)


@pytest.fixture
def two_maps(tmp_path):
    """A folder with two maps, two runs on each, and a campaign file."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_geotiff(tmp_path / f"{name}.tif", waves())
        for k in range(2):
            drive(tmp_path / name, "run.csv" if k else "first.csv", y=3.0 + k + 0.5 * (name == "b"))
    (tmp_path / "robot.toml").write_text("rolling_resistance = 0.1\n")
    (tmp_path / "campaign.toml").write_text(
        'robot = "robot.toml"\n[[site]]\nheightmap = "a.tif"\nruns = "a/*.csv"\n'
        '[[site]]\nheightmap = "b.tif"\nruns = ["b/first.csv", "b/run.csv"]\n'
    )
    return tmp_path


def test_pairs_options_and_a_campaign_file_are_one_training(two_maps):
    pairs = [(two_maps / f"{name}.tif", two_maps / name) for name in ("a", "b")]
    made = jm.train(sites=pairs, robot=ROBOT, out=two_maps / "one", epochs=1)
    assert made.facts["runs"] == ["a/first.csv", "a/run.csv", "b/first.csv", "b/run.csv"]
    assert set(made.held_out["rmse_j_by_run"]) == set(made.facts["runs"])
    card = (two_maps / "one" / "MODEL_CARD.md").read_text()
    assert "a ridge regression on shape, turning, time and speeding up |" in card
    assert "| speed_mps | 0.5 .. 0.5 |" in card
    assert len(read_artifact(two_maps / "one").training["heightmaps"]) == 2
    campaign = jm.train(campaign=two_maps / "campaign.toml", out=two_maps / "two", epochs=1)
    assert campaign.facts["version"] == made.facts["version"]
    sites = [word for name in ("a", "b") for word in ("--site", f"{two_maps / name}.tif={two_maps / name}/*.csv")]
    robot = ("--robot", two_maps / "robot.toml")
    code, said, _ = joulemap("train", *sites, *robot, "--out", two_maps / "three", "--epochs", 1)
    assert code == 0
    assert f"version {made.facts['version']}" in said
    assert "a ridge regression" in said
    told = jm.evaluate(sites=pairs, robot=ROBOT, model=made).document
    code, _, _ = joulemap("evaluate", *sites, *robot, "--model", two_maps / "one", "--json", two_maps / "found.json")
    assert json.loads((two_maps / "found.json").read_text())["rmse_j"] == told["rmse_j"]
    assert code == 0


def test_robots_of_two_sizes_are_learned_together_and_said(two_maps):
    heavy = Robot(name="mule", mass_kg=70.0, rolling_resistance=0.1)
    pairs = [(two_maps / "a.tif", two_maps / "a"), (two_maps / "b.tif", two_maps / "b", heavy)]
    made = jm.train(sites=pairs, robot=ROBOT, out=two_maps / "mine", epochs=1)
    assert "robots of 35, 70 kg drove" in made.warnings[-1]
    low, high = read_artifact(two_maps / "mine").domain.robot["mass_kg"]
    assert low < 35.0
    assert high > 70.0


def test_what_is_no_site_is_refused_in_words(two_maps):
    run = two_maps / "a" / "run.csv"
    with pytest.raises(InputError, match="give a heightmap and its runs, or `sites`, or a `campaign` file"):
        jm.train(two_maps / "a.tif", out=two_maps / "x")
    with pytest.raises(InputError, match=r"run\.csv is given twice"):
        jm.train(sites=[(two_maps / f"{name}.tif", run) for name in ("a", "b")], out=two_maps / "x")
    with pytest.raises(InputError, match=r"site 1 is .*give pairs"):
        jm.train(sites=[two_maps / "a.tif"], out=two_maps / "x")
    with pytest.raises(NotFoundError, match=r"there is no heightmap nowhere\.tif"):
        sites_of_options(["nowhere.tif=a.csv"])
    with pytest.raises(InputError, match="is no site: write HEIGHTMAP=RUNS"):
        sites_of_options([str(run)])
    map_a = two_maps / "a.tif"
    assert sites_of_options([f"{map_a}={run}", str(two_maps / "b.csv")]) == [
        (map_a, [str(run), str(two_maps / "b.csv")])
    ]
    campaign = two_maps / "wrong.toml"
    for text, words in (
        ('[[site]]\nheightmap = "a.tif"\n', "site 1: `runs` is missing"),
        ('[[site]]\nheightmap = "a.tif"\nruns = "a"\nrobots = "r.toml"\n', "robots: unknown; did you mean robot"),
        ('sites = "a"\n', "sites: unknown; did you mean site"),
        ("", "it has no"),
    ):
        campaign.write_text(text)
        with pytest.raises(InputError, match=words):
            read_campaign(campaign)


def test_a_model_that_is_worse_than_the_ridge_regression_says_so():
    told = {"rmse_j": 300.0}, {"a ridge regression": {"rmse_j": 250.0}, "a constant": {"rmse_j": 400.0}}
    (warning,) = _warnings(*told, [])
    assert "a ridge regression predicts runs that were left out better" in warning
    assert "250 J against 300 J" in warning
    assert not _warnings({"rmse_j": 240.0}, told[1], [])


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "drive").is_dir(), reason=f"no real data in {REAL}")
def test_four_drives_of_a_warthog_predict_the_fifth_as_well_as_the_best_simple_model(tmp_path):
    files = sorted((REAL / "drive").glob("*.csv"))
    made = jm.train(
        sites=[(jm.heightmap_from_runs(file), file) for file in files], robot=WARTHOG, out=tmp_path / "warthog"
    )
    facts = made.facts
    used = facts["coverage"]
    assert used["used_m"] > 0.9 * used["track_m"]
    simple = {name: found for name, found in facts["baselines"].items() if "fine-tuning" not in name}
    assert len(simple) == 3
    for run, error in made.held_out["rmse_j_by_run"].items():
        assert error < 1.1 * min(found["rmse_j_by_run"][run] for found in simple.values()), run
    assert made.held_out["rmse_j"] < 1.005 * min(found["rmse_j"] for found in simple.values())
    assert made.held_out["mean_absolute_error_j"] < min(found["mean_absolute_error_j"] for found in simple.values())
    better = any(found["rmse_j"] < made.held_out["rmse_j"] for found in simple.values())
    assert len(facts["warnings"]) == better  # a simple model that does better is said
    assert 3000.0 < facts["turn_j_per_rad"] < 6000.0  # scrubbing a quarter of the weight at about half a metre
    assert 0.0 < facts["drive_costs"]["speed_up_kg"] <= 2.0 * WARTHOG.mass_kg
    slow, fast = read_artifact(tmp_path / "warthog").domain.driven["speed_mps"]
    assert slow < 0.5 < 1.4 < fast
    own = jm.evaluate(jm.heightmap_from_runs(files[0]), files[0], robot=WARTHOG, model=made)
    assert "trained on 1 of these 1 runs" in own.warnings[0]
