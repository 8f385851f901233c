"""Commands that run as a whole on a worker of a Dask scheduler: what they write is what they write at home."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from joulemap.model.energy.artifact import read_artifact
from joulemap.model.terrain.writers import write_geotiff
from joulemap.model.training.distillation import distil_on_runs
from tests.reference.one_site import train_on_runs
from tests.service.clusters import shared_scheduler
from tests.service.test_learning import ROBOT, SHIPPED, drive, waves


def there(folder: Path, *words: str) -> str:
    """What a command says that runs on a worker. It is called as a person calls it: with relative names."""
    command = [sys.executable, "-m", "joulemap.service.cli", *words, "--scheduler", shared_scheduler()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A folder with a heightmap, a robot file, and runs."""
    folder = tmp_path_factory.mktemp("field")
    runs = [drive(folder, f"run{k}.csv", y=2.0 + k) for k in range(3)]
    write_geotiff(folder / "dem.tif", waves())
    (folder / "robot.toml").write_text(f"rolling_resistance = {ROBOT.rolling_resistance}\n", encoding="utf-8")
    return folder, runs


MEASURED = ("--heightmap", "dem.tif", "--robot", "robot.toml", "--runs", "run*.csv", "--epochs", "1")


@pytest.mark.slow
def test_a_model_is_trained_and_taught_on_a_worker(field: tuple[Path, list[Path]]) -> None:
    folder, runs = field
    there(folder, "train", *MEASURED, "--arch", "resnet18", "--patch-size", "32", "--out", "teacher")
    here = train_on_runs(waves(), ROBOT, runs, out=folder / "mine", architecture="resnet18", patch_size=32, epochs=1)
    assert read_artifact(folder / "teacher").training["held_out_runs"] == here.held_out_runs
    there(folder, "distill", *MEASURED, "--teacher", "teacher", "--answers", "100", "--out", "fast")
    options = {"teacher": folder / "teacher", "start_from": SHIPPED, "answers": 100, "epochs": 1}
    student = distil_on_runs(waves(), ROBOT, runs, out=folder / "student", **options)
    taught = read_artifact(folder / "fast")
    assert taught.training["held_out_runs"] == student.held_out_runs
