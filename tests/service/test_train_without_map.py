"""Training on logs with a speed and no positions, through the command line and Python, and the model on another log."""

import json
from pathlib import Path

import pytest

import joulemap as jm
from joulemap.model.errors import InputError
from tests.service import test_calibrate_without_map as drives
from tests.service.test_cli import joulemap

WRONG = drives.CAR.as_dict() | {"rolling_resistance": 0.05}  # the drives take 0.02


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("drives")
    (folder / "car.toml").write_text("".join(f"{k} = {json.dumps(v)}\n" for k, v in WRONG.items()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drives, "HEATING", 0.0)
        for number in range(4):
            (folder / f"drive_{number}.csv").write_text(drives.log(number, heater=None))
    return sorted(folder.glob("*.csv"))


def test_a_model_of_drives_without_a_map_predicts_another_drive(files, tmp_path):
    *learned, other = files
    given = [word for file in learned for word in ("--runs", file)]
    robot = ["--robot", other.parent / "car.toml"]
    code, said, wrong = joulemap("train", *given, *robot, "--out", tmp_path / "mine")
    assert code == 0, wrong
    assert "the shape of the ground, beyond its slope, costs nothing" in " ".join((said + wrong).split())
    errors = []
    for model in ("physics", tmp_path / "mine"):
        code, _, wrong = joulemap(
            "evaluate", "--model", model, "--runs", other, *robot, "--json", tmp_path / "found.json"
        )
        assert code == 0, wrong
        errors.append(json.loads((tmp_path / "found.json").read_text()))
    assert errors[0]["error_share"] > 0.5
    assert errors[1]["error_share"] < 0.06  # 60 W of noise in 0.5 s, of about 420 J a segment: 4.8 %
    assert errors[1]["route_relative_error"] < 0.02


def test_what_learns_from_the_shape_of_the_ground_is_refused_without_a_map(files, tmp_path):
    for options, learner in (({"architecture": "resnet18"}, "resnet18"), ({"start_from": "none"}, "random weights")):
        with pytest.raises(InputError, match=f"no map, and .*{learner}.*give the heightmap, or train `compact`"):
            jm.train(runs=files, robot=drives.CAR, out=tmp_path / "no", **options)
    assert not (tmp_path / "no").exists()
