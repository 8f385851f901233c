"""A compact model out of a ResNet18 teacher: what it is taught, what it is judged by, and what is refused."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from joulemap.model.energy.architectures.compact.net import CompactNet
from joulemap.model.energy.artifact import read_artifact
from joulemap.model.energy.physics import PhysicsPredictor, eq5_traction_per_m
from joulemap.model.errors import InputError, ModelError
from joulemap.model.terrain.writers import write_geotiff
from joulemap.model.training.distillation import TAUGHT, ask_teacher, difference, distil_on_runs
from joulemap.service.cli import app
from tests.reference.one_site import train_on_runs
from tests.service.test_learning import ROBOT, SHIPPED, drive, waves


def test_a_teacher_is_asked_at_places_that_it_knows():
    shares = []
    told = ask_teacher(
        PhysicsPredictor(), waves(), ROBOT, count=700, rng=np.random.default_rng(0), progress=shares.append
    )
    assert 400 < len(told) <= 700  # squares that leave the map are no examples
    assert (told.run == TAUGHT).all()
    expected = ROBOT.hotel_per_m + eq5_traction_per_m(ROBOT.weight_n, ROBOT.rolling_resistance, told.tan_grade)
    np.testing.assert_allclose(told.energy_j, expected, rtol=1e-5)
    assert shares[-1] == 1.0


def test_a_model_does_not_differ_from_itself():
    assert difference(PhysicsPredictor(), PhysicsPredictor(), waves(), ROBOT, count=200, seed=1) == 0.0


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """A folder with a heightmap, a robot file, three runs and a teacher that held one of them out."""
    folder = tmp_path_factory.mktemp("field")
    runs = [drive(folder, f"run{k}.csv", y=2.0 + k) for k in range(3)]
    write_geotiff(folder / "dem.tif", waves())
    (folder / "robot.toml").write_text(f"rolling_resistance = {ROBOT.rolling_resistance}\n", encoding="utf-8")
    train_on_runs(waves(), ROBOT, runs, out=folder / "teacher", architecture="resnet18", patch_size=32, epochs=1)
    return folder, runs


@pytest.mark.slow
def test_a_student_is_judged_by_the_runs_that_its_teacher_had_not_seen(field):
    folder, runs = field
    options = {"teacher": folder / "teacher", "start_from": SHIPPED, "answers": 100, "epochs": 1}
    model = distil_on_runs(waves(), ROBOT, runs, out=folder / "student", **options)
    teacher, student = read_artifact(folder / "teacher"), read_artifact(folder / "student")
    assert isinstance(student.net, CompactNet)
    assert model.held_out_runs == teacher.training["held_out_runs"]
    assert model.teacher_held_out["segments"] == model.student_held_out["segments"] > 25
    assert np.isfinite(model.difference)
    assert student.training["teacher"] == str(folder / "teacher")
    assert student.spread.segments > 0
    seen = [run for run in runs if run.name not in model.held_out_runs]
    with pytest.raises(InputError, match="had not seen"):
        distil_on_runs(waves(), ROBOT, seen, out=folder / "none", **options)


def test_only_a_resnet18_teaches_and_only_a_compact_network_learns(field):
    folder, runs = field
    with pytest.raises(ModelError, match="no resnet18"):
        distil_on_runs(waves(), ROBOT, runs, teacher=SHIPPED, start_from=SHIPPED, out=folder / "x")
    with pytest.raises(ModelError, match="no compact"):
        distil_on_runs(
            waves(), ROBOT, runs, teacher=folder / "teacher", start_from=folder / "teacher", out=folder / "x"
        )


def test_the_command_says_what_the_document_has(field):
    folder, _ = field
    given = {"teacher": "teacher", "heightmap": "dem.tif", "robot": "robot.toml", "runs": "run*.csv", "out": "fast"}
    words = [word for name, file in given.items() for word in (f"--{name}", str(folder / file))]
    done = CliRunner().invoke(app, ["distill", *words, "--answers", "100", "--epochs", "1", "--json", "-"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout[done.stdout.index("{") :])
    assert said["version"] == json.loads((folder / "fast" / "config.json").read_text())["version"]
    assert said["teacher_held_out"]["segments"] == said["student_held_out"]["segments"] > 25
    assert np.isfinite(said["difference"])
