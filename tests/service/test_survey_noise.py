"""From a noisy survey to the cost map: on the command line, over HTTP and in Python, with and without being told."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.synthesis import TerrainRecipe, make_terrain
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.survey_error import with_survey_error
from joulemap.service.cli import app

NOISE_M = 0.05
ROBOT = {"wheel_radius_m": 0.4}
"""Its wheels roll over what the noise of the survey looks like."""


@pytest.fixture(scope="module")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A smooth hill of 30 x 30 m, surveyed without noise and as a drone does."""
    folder = tmp_path_factory.mktemp("surveys")
    y, x = np.mgrid[0:120, 0:120] * 0.25
    hill = 2.0 * np.sin(x / 8.0) * np.cos(y / 6.0)
    noise = NOISE_M * np.random.default_rng(4).standard_normal(hill.shape)
    frame = GridFrame(0.0, 30.0, 0.25, 120, 120)
    for name, heights in (("clean", hill), ("noisy", hill + noise)):
        write_geotiff(folder / f"{name}.tif", Heightmap(heights.astype(np.float32), frame))
    (folder / "robot.toml").write_text("".join(f"{key} = {value}\n" for key, value in ROBOT.items()))
    (folder / "small.toml").write_text("wheel_radius_m = 0.127\n")
    return {name: folder / f"{name}.tif" for name in ("clean", "noisy")}


def made(survey: Path, *options: str, robot: str = "robot.toml") -> tuple[dict, str]:
    """The document of `joulemap costmap` and what it prints."""
    out = survey.with_suffix(".json")
    command = ["costmap", str(survey), "--out", str(survey.with_suffix(".zarr")), "--overwrite", "--json", str(out)]
    command += ["--robot", str(survey.with_name(robot))]
    done = CliRunner().invoke(app, [*command, *options])
    assert done.exit_code == 0, done.output
    return json.loads(out.read_text(encoding="utf-8")), " ".join(done.output.split())


def test_the_command_takes_the_noise_out_and_says_so(surveys):
    clean, noisy = made(surveys["clean"])[0], made(surveys["noisy"])
    as_it_is = made(surveys["noisy"], "--noise", "0")[0]
    mean = clean["energy_per_m"]["mean"]
    assert mean < noisy[0]["energy_per_m"]["mean"] < 1.3 * mean  # as much rougher as ground is that cannot be seen
    assert as_it_is["energy_per_m"]["mean"] > 1.5 * mean
    assert noisy[0]["provenance"]["heightmap"]["noise_m"] == pytest.approx(NOISE_M, rel=0.1)
    assert "the map's heights are uncertain by about 5" in noisy[1]
    assert "Steps of up to" not in noisy[1]
    assert "Steps of up to" in made(surveys["noisy"], robot="small.toml")[1]  # such as its wheels do not climb
    assert not any("uncertain" in warning for warning in clean["warnings"] + as_it_is["warnings"])


def test_noise_with_a_length_is_told_on_the_command_line_in_python_and_over_http(surveys, client):
    told = made(surveys["noisy"], "--noise", "0.05", "--noise-length", "0.5")[0]
    white = made(surveys["noisy"], "--noise", "0.05")[0]
    assert told["provenance"]["heightmap"]["noise_length_m"] == 0.5
    assert (
        told["energy_per_m"]["mean"] > white["energy_per_m"]["mean"]
    )  # this noise is white: more of it is taken for ground
    lattice = jm.costmap(jm.read_heightmap(surveys["noisy"], noise_m=0.05, noise_length_m=0.5), ROBOT).lattice
    assert np.nanmean(np.maximum(lattice.traction_per_m, 0.0)) > 0.0
    assert lattice.provenance["heightmap"]["noise_length_m"] == 0.5
    files = {"file": ("dem.tif", surveys["noisy"].read_bytes())}
    kept = client.post("/v1/heightmaps", files=files, data={"noise_m": 0.05, "noise_length_m": 0.5}).json()
    assert (kept["noise_m"], kept["noise_length_m"]) == (0.05, 0.5)
    done = client.post(
        "/v1/costmaps", json={"heightmap_id": kept["id"], "robot": ROBOT}, headers={"Prefer": "wait=300"}
    ).json()
    assert done["energy_per_m"]["mean"] == pytest.approx(told["energy_per_m"]["mean"], rel=1e-4)
    alone = client.post("/v1/heightmaps", files=files, data={"noise_length_m": 0.5})
    assert alone.status_code == 422
    assert "give its standard deviation too" in alone.text


def test_info_says_what_noise_it_cannot_see(surveys):
    def _said(*options: str) -> str:
        done = CliRunner().invoke(app, ["info", str(surveys["noisy"]), *options])
        assert done.exit_code == 0, done.output
        return " ".join(done.output.split())

    assert "give --noise and --noise-length" in _said()
    assert "alike over 0.5 m" in _said("--noise", "0.05", "--noise-length", "0.5")


def test_noise_that_cannot_be_is_refused(surveys):
    out = str(surveys["noisy"].with_name("refused.zarr"))
    done = CliRunner().invoke(app, ["costmap", str(surveys["noisy"]), "--out", out, "--noise", "11"])
    assert done.exit_code == 2
    assert "--noise: Input should be less than or equal to 10, got 11" in " ".join(done.output.split())


def test_python_says_the_noise_and_prices_the_ground_without_it(surveys):
    ground = jm.read_heightmap(surveys["noisy"])
    assert ground.noise_m == pytest.approx(NOISE_M, rel=0.1)
    told = jm.costmap(jm.read_heightmap(surveys["noisy"], noise_m=0.0), ROBOT).lattice
    assert (
        jm.costmap(ground, ROBOT).lattice.traction_per_m[5:-5, 5:-5].mean()
        < told.traction_per_m[5:-5, 5:-5].mean() / 1.5
    )


def test_a_service_keeps_the_noise_beside_the_map(client, surveys):
    def sent(**options: float) -> dict:
        content = surveys["noisy"].read_bytes()
        answer = client.post("/v1/heightmaps", files={"file": ("dem.tif", content)}, data=options)
        assert answer.status_code == 201, answer.text
        return answer.json()

    def map_of(heightmap: dict) -> dict:
        wish = {"heightmap_id": heightmap["id"], "robot": ROBOT}
        made = client.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}).json()
        assert made["status"] == "done", made
        return made

    estimated, told = sent(), sent(noise_m=0.0)
    assert estimated["noise_m"] == pytest.approx(NOISE_M, rel=0.1)
    assert told["noise_m"] == 0.0
    quiet, as_it_is = map_of(estimated), map_of(told)
    assert any("uncertain by about" in warning for warning in quiet["warnings"])
    assert quiet["energy_per_m"]["mean"] < as_it_is["energy_per_m"]["mean"] / 1.3
    assert client.post("/v1/heightmaps", files={"file": ("dem.tif", b"x")}, data={"noise_m": 11.0}).status_code == 422


@pytest.fixture(scope="module")
def photogrammetry(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Rough ground of 40 x 40 m on cells of 0.25 m, and with 25 and 100 mm of noise that is alike over 0.3 m."""
    folder = tmp_path_factory.mktemp("photogrammetry")
    rng = np.random.default_rng(8)
    frame = GridFrame(0.0, 40.0, 0.25, 160, 160)
    recipe = TerrainRecipe(max_slope_deg=8.0, roughness_rms_m=0.015, bumps_per_m2=1.0, relief_longest_m=30.0)
    ground = make_terrain(recipe, frame, rng)
    noise = gaussian_filter(rng.standard_normal(frame.shape), 0.3 / 0.25 / np.sqrt(2.0), mode="wrap")
    write_geotiff(folder / "clean.tif", ground)
    for name, noise_m in (("doubtful", 0.025), ("noisy", 0.1)):
        survey = ground.heights + np.float32(noise_m / noise.std()) * noise.astype(np.float32)
        write_geotiff(folder / f"{name}.tif", Heightmap(survey, frame))
    (folder / "robot.toml").write_text("".join(f"{key} = {value}\n" for key, value in ROBOT.items()))
    return {name: folder / f"{name}.tif" for name in ("clean", "doubtful", "noisy")}


def test_noise_that_is_alike_over_a_cell_is_seen_and_taken_out(photogrammetry):
    said = CliRunner().invoke(app, ["info", str(photogrammetry["noisy"]), "--json", "-"])
    assert said.exit_code == 0, said.output
    seen = json.loads(said.stdout)
    assert seen["noise_m"] == pytest.approx(0.1, rel=0.1)
    assert seen["noise_length_m"] == pytest.approx(0.3, rel=0.15)
    clean, noisy = made(photogrammetry["clean"])[0], made(photogrammetry["noisy"])[0]
    as_it_is = made(photogrammetry["noisy"], "--noise", "0")[0]
    mean = clean["energy_per_m"]["mean"]
    assert 0.8 * mean < noisy["energy_per_m"]["mean"] < 1.2 * mean  # rough ground that noise hides comes out as usual
    assert as_it_is["energy_per_m"]["mean"] > 2.0 * mean
    assert noisy["provenance"]["heightmap"]["noise_length_m"] == pytest.approx(0.3, rel=0.15)


def test_bumps_of_many_heights_are_no_noise(photogrammetry):
    said = CliRunner().invoke(app, ["info", str(photogrammetry["clean"])])
    assert said.exit_code == 0, said.output
    assert "are taken for noise with a probability of 0%" in " ".join(said.output.split())
    ground = jm.read_heightmap(photogrammetry["clean"])
    assert ground.noise_length_m == 0.0
    assert ground.noise_m < 0.02


def test_bumps_that_are_noise_or_ground_count_by_their_probability_and_widen_the_odds(photogrammetry):
    said = " ".join(CliRunner().invoke(app, ["info", str(photogrammetry["doubtful"])]).output.split())
    assert 0.3 < float(re.search(r"for noise with a probability of (\d+)%", said)[1]) / 100.0 < 0.95
    given = re.search(r"If they are noise, give (--noise \S+ --noise-length [\d.]+);", said)[1].split()
    doubtful = made(photogrammetry["doubtful"])[0]
    ground, noise = (made(photogrammetry["doubtful"], *options)[0] for options in (["--noise", "0"], given))
    means = [document["energy_per_m"]["mean"] for document in (noise, doubtful, ground)]
    assert means == sorted(means)
    known, perhaps = (document["provenance"]["model"]["spread"]["run_share"] for document in (noise, doubtful))
    assert known < 0.05
    assert any("all energies of the map are uncertain by" in warning for warning in doubtful["warnings"])
    assert not any("all energies" in warning for warning in noise["warnings"] + ground["warnings"])
    assert perhaps > 0.3 * (means[2] - means[0]) / means[1]


def test_a_model_of_runs_on_a_map_has_its_bumps_in_its_odds_already(photogrammetry):
    ground, physics = jm.read_heightmap(photogrammetry["doubtful"]), load_predictor("physics")
    model = {"spread": Spread().as_dict(), "heightmaps": ["another"]}
    wider, _ = with_survey_error(model, ground, jm.Robot(), physics)
    assert wider["spread"]["run_share"] > model["spread"]["run_share"]
    model["heightmaps"] = [ground.data_hash]
    assert with_survey_error(model, ground, jm.Robot(), physics) == (model, [])
