"""From runs to a model in the corners: one run, runs of another place, trainings cut off, and what a folder keeps."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.energy.artifact import read_artifact
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.residuals_of_runs import base_residuals
from joulemap.model.errors import InputError, ModelError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.correction import Correction
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import read_calibration_runs
from joulemap.model.runs.files import read_segments
from joulemap.model.runs.record import RECORD_FILE
from joulemap.model.runs.sites import Site
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.analysis.cost_lattices import make_cost_lattice
from joulemap.service.library.calibrations import CalibrationResult
from joulemap.service.loop.calibration import calibrate_on_runs
from joulemap.service.models import find_predictor, load_model, planning_robot
from tests.reference.one_site import evaluate_on_runs, train_on_runs

ROBOT = Robot(rolling_resistance=0.1)
SHIPPED = Path(__file__).resolve().parents[2] / "model" / "weights"


def waves() -> Heightmap:
    frame = GridFrame(0.0, 8.0, 0.25, 32, 160)
    x, y = frame.centres()
    return Heightmap((0.3 * np.sin(x[None, :] / 3.0) + 0.1 * np.cos(y[:, None])).astype(np.float32), frame)


def drive(
    folder: Path, name: str, *, y: float, columns: str = "voltage", payload_kg: float = 0.0, more: float = 1.2
) -> Path:
    """A log of 36 m straight to the east, `more` times what equation 5 asks for."""
    t = np.arange(0.0, 72.0, 0.1)
    x = 2.0 + ROBOT.speed_mps * t
    grade = tan_grade(waves(), x, 4.0, np.pi / 2)
    power = more * ROBOT.price_per_m(ROBOT.weight_n * (ROBOT.rolling_resistance + grade)) * ROBOT.speed_mps
    volts = ROBOT.nominal_voltage_v
    rows = [
        f"{a:.2f},{b:.4f},{y},{p / volts:.5f},{payload_kg}" + (f",{volts}" if columns else "")
        for a, b, p in zip(t, x, power, strict=True)
    ]
    file = folder / name
    file.write_text("\n".join([f"t,x,y,current,payload{',' + columns if columns else ''}", *rows]) + "\n")
    return file


def train(files, out, **options):
    return train_on_runs(waves(), ROBOT, files, out=out, epochs=1, start_from=SHIPPED, **options)


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A folder with two runs and a model of them, `mine`."""
    folder = tmp_path_factory.mktemp("learned")
    files = [drive(folder, f"{k}.csv", y=2.0 + k, more=1.2 + 0.01 * k) for k in range(2)]
    train(files, folder / "mine")
    return folder, files


@pytest.fixture
def mine(learned, tmp_path):
    """Its two runs, and a copy of the model."""
    return learned[1], Path(shutil.copytree(learned[0] / "mine", tmp_path / "mine"))


def test_a_single_run_is_held_out_stretch_by_stretch(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr("joulemap.model.training.measured_runs.keep_base_runs", lambda *given: kept.append(given[3]))
    run = drive(tmp_path, "run.csv", y=4.0)
    model = train([run], tmp_path / "model")
    assert model.held_out_runs == ["run.csv"]
    assert model.held_out["segments"] == model.segments > 25
    assert (np.diff(kept[0].x) > 0.0).all()  # as driven, though the stretches were dealt out at random


def test_segments_at_the_maps_edge_are_counted_though_their_turned_squares_leave_the_map(tmp_path):
    files = [drive(tmp_path, f"{y}.csv", y=y) for y in (0.2, 7.8)]
    segments = read_segments(files, ROBOT, crs=None)[1]
    assert train(files, tmp_path / "model").segments == len(segments)


def test_runs_beside_the_map_are_refused_in_words(tmp_path):
    files = [drive(tmp_path, f"{k}.csv", y=500.0 + k) for k in range(2)]
    with pytest.raises(RunsError, match="lie off the heightmap: they span"):
        train(files, tmp_path / "model")
    with pytest.raises(RunsError, match="lie off the heightmap: they span"):
        train_on_runs(waves(), ROBOT, files, out=tmp_path / "model", epochs=1)
    files[1].write_text(files[1].read_text().replace("t,x,y,", "t,distance,pa,"))
    for read in (
        lambda: train(files, tmp_path / "model"),
        lambda: read_calibration_runs([Site(waves(), files, ROBOT)]),
    ):
        with pytest.raises(RunsError, match=r"1\.csv: no position was .* are pa\. .* --map x=pa"):
            read()


def test_a_training_cut_off_goes_on_to_the_same_weights_and_never_from_another_start(tmp_path):
    files = [drive(tmp_path, f"{k}.csv", y=2.0 + 2.0 * k) for k in range(3)]
    whole, out = train(files, tmp_path / "whole"), tmp_path / "cut"

    class Killed(Exception):
        pass

    def kill(done: float) -> None:
        if done > 0.5:
            raise Killed

    with pytest.raises(Killed):
        train(files, out, progress=kill)
    with pytest.raises(ModelError, match="another training"):
        train_on_runs(waves(), ROBOT, files, out=out, epochs=1, start_from=tmp_path / "whole", resume=True)
    assert train(files, out, resume=True).version == whole.version
    assert not list(out.glob("*.pt"))


def test_a_damaged_state_of_a_training_is_named(tmp_path):
    files = [drive(tmp_path, f"{k}.csv", y=2.0 + 2.0 * k) for k in range(2)]
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "0.training.pt").write_bytes(b"half a file")
    with pytest.raises(ModelError, match=r"0\.training\.pt is damaged"):
        train(files, tmp_path / "model", resume=True)


@pytest.mark.slow
def test_a_resnet_goes_on_with_the_patches_it_was_trained_on(tmp_path):
    files = [drive(tmp_path, f"{k}.csv", y=2.0 + 2.0 * k) for k in range(2)]
    first = {"architecture": "resnet18", "patch_size": 32, "epochs": 1}
    train_on_runs(waves(), ROBOT, files, out=tmp_path / "first", **first)
    tuned = {"architecture": "resnet18", "start_from": tmp_path / "first", "epochs": 1}
    with pytest.raises(InputError, match="reads patches of 32 rows, not 64"):
        train_on_runs(waves(), ROBOT, files, out=tmp_path / "tuned", patch_size=64, **tuned)
    train_on_runs(waves(), ROBOT, files, out=tmp_path / "tuned", **tuned)
    assert read_artifact(tmp_path / "tuned").size == 32


def test_the_runs_of_a_model_are_its_own_and_are_missed(tmp_path):
    files = [drive(tmp_path, f"{k}.csv", y=2.0 + 2.0 * k) for k in range(2)]
    model, record = tmp_path / "model", tmp_path / "model" / RECORD_FILE

    def baseline():
        return base_residuals(model, load_model(model), waves(), ROBOT, None)

    train(files, model)
    assert baseline().runs == tuple(file.name for file in files)
    train([drive(tmp_path, f"other {k}.csv", y=3.0 + k) for k in range(2)], tmp_path / "other")
    record.write_bytes((tmp_path / "other" / RECORD_FILE).read_bytes())
    with pytest.raises(ModelError, match=rf"{RECORD_FILE} is damaged, or of another training"):
        baseline()
    record.unlink()
    with pytest.raises(ModelError, match=rf"{RECORD_FILE} is missing, the runs that this model was trained on"):
        baseline()
    train(files, model)
    train(files, model, charge=True)
    assert not record.exists()  # those of the model before do not stay
    assert baseline() is None


def test_runs_with_and_without_voltage_are_learned_together(tmp_path):
    files = [drive(tmp_path, "with.csv", y=3.0), drive(tmp_path, "without.csv", y=3.0, columns="")]
    energy = read_segments(files, ROBOT, crs=None)[1].energy_j
    one, other = np.split(energy, 2)
    np.testing.assert_allclose(one, other, rtol=1e-6)  # the voltage was the nominal one throughout


def test_plans_pay_for_the_turns_that_a_models_runs_paid_for(mine):
    config = mine[1] / "config.json"
    values = json.loads(config.read_text())
    del values["checksum"]
    costs = {"turn_j_per_rad": 4.0}
    config.write_text(json.dumps(values | {"drive_costs": costs}))
    declared = Robot(turn_j_per_rad=2.0)
    lattice = make_cost_lattice(waves(), declared, model=mine[1], headings=8)
    assert lattice.robot.turn_j_per_rad == 6.0
    del values["drive_costs"]  # as version 0.1 wrote it
    config.write_text(json.dumps(values | {"turn_j_per_rad": 7.0}))
    assert planning_robot(find_predictor(mine[1]), declared).turn_j_per_rad == 9.0


def test_what_straight_segments_turn_is_in_the_prices_already(tmp_path):
    """Of two models that differ in turning alone, that with 50 J/rad from 0.1 rad on says 50 (|turn| - 0.1) more."""
    plain, turning = load_predictor("default"), load_predictor("default")
    turning.costs, turning.domain = DriveCosts(turn_j_per_rad=50.0), replace(turning.domain, turned_rad=0.1)
    segments = read_segments([drive(tmp_path, "run.csv", y=4.0)], ROBOT, crs=None)[1]
    segments = replace(segments, turned_abs_rad=np.linspace(0.0, 0.4, len(segments)))
    one, other = (predict_segments(p, waves(), ROBOT, segments).energy_j for p in (plain, turning))
    np.testing.assert_allclose(other - one, 50.0 * (segments.turned_abs_rad - 0.1), atol=1e-9)


def test_a_calibration_without_effects_changes_no_prediction_with_or_without_a_load(tmp_path):
    base = load_predictor("default")
    base.domain = Domain(base.domain.robot, base.domain.resolution_m, base.domain.max_slope_deg, (0.0, 20.0))
    calibrated = CalibratedPredictor(base, Correction((), ()), name="mine", version="1")
    files = [drive(tmp_path, f"{kg}.csv", y=4.0, payload_kg=kg) for kg in (0.0, 8.0)]
    empty, loaded = (read_segments([file], ROBOT, crs=None)[1] for file in files)
    plain, same = (predict_segments(model, waves(), ROBOT, empty) for model in (base, calibrated))
    np.testing.assert_allclose(same.energy_j, plain.energy_j)
    np.testing.assert_array_equal(same.std_j, plain.std_j)
    assert (loaded.extras["payload"] == 8.0).all()
    heavier = predict_segments(base, waves(), ROBOT, loaded).energy_j
    assert heavier.sum() > 1.05 * plain.energy_j.sum()
    np.testing.assert_allclose(predict_segments(calibrated, waves(), ROBOT, loaded).energy_j, heavier)
    charge = CalibratedPredictor(base, Correction((), (), charge=True), name="mine", version="1")
    assert np.isfinite(predict_segments(charge, waves(), ROBOT, loaded).energy_j).all()


def test_a_forgotten_robot_file_is_a_warning_wherever_the_model_answers(tmp_path, mine):
    model, other = find_predictor(tmp_path / "mine"), replace(ROBOT, name="mule", mass_kg=68.0)
    words = (
        "this robot is mule (68 kg), but the model mine was trained with rover-4wd (35 kg): "
        "give that robot's file, or expect errors"
    )
    new = [drive(tmp_path, f"new{k}.csv", y=5.5 + 0.2 * k, more=1.1 + 0.01 * k) for k in range(2)]
    reports = {
        robot.name: calibrate_on_runs(
            tmp_path / "mine",
            read_calibration_runs([Site(waves(), tuple(new), robot)]),
            out=tmp_path / robot.name,
        ).document
        for robot in (ROBOT, other)
    }
    found = {
        robot.name: {
            "costmap": make_cost_lattice(waves(), robot, model=tmp_path / "mine", headings=4).provenance["warnings"],
            "evaluate": evaluate_on_runs(model, waves(), robot, new)["warnings"],
            "calibrate": reports[robot.name]["warnings"],
        }
        for robot in (ROBOT, other)
    }
    assert all(words in said for said in found["mule"].values())
    assert f"Warning: {words}" in str(CalibrationResult(tmp_path / "mule", reports["mule"]))
    assert not any("trained with" in " ".join(said) for said in found[ROBOT.name].values())


def test_evaluation_on_runs_that_trained_the_model_says_so(tmp_path, mine):
    files, new = mine[0], drive(tmp_path, "new.csv", y=5.5, more=1.1)
    renamed = tmp_path / "renamed.csv"
    renamed.write_bytes(files[1].read_bytes())

    def judged(*runs: Path) -> tuple[list[str], list[str]]:
        found = evaluate_on_runs(find_predictor(tmp_path / "mine"), waves(), ROBOT, runs)
        return found["seen_in_training"], [words for words in found["warnings"] if "runs" in words]

    seen, words = judged(renamed, new)
    assert seen == ["renamed.csv"]
    assert len(words) == 1
    assert words[0].startswith(
        "the model was trained on 1 of these 2 runs: renamed.csv. The errors on them are not held"
    )
    assert judged(new) == ([], [])
    config = tmp_path / "mine" / "config.json"  # a model from before runs were recorded by their data
    values = json.loads(config.read_text())
    del values["training"]["run_hashes"], values["checksum"]
    config.write_text(json.dumps(values))
    assert judged(renamed) == ([], [])
    seen, words = judged(files[0], new)
    assert seen == ["0.csv"]
    assert "by their names: this model keeps no record" in words[0]
    values["training"] |= {"held_out_runs": ["0.csv"], "stopped_by_held_out": True}
    config.write_text(json.dumps(values))
    assert "1 of these 1 runs decided when the model's training stopped" in judged(files[0])[1][0]
    calibrated = CalibratedPredictor(find_predictor(tmp_path / "mine"), Correction((), ()), name="x", version="1")
    assert evaluate_on_runs(calibrated, waves(), ROBOT, files[:1])["seen_in_training"] == ["0.csv"]
    assert evaluate_on_runs(find_predictor("physics"), waves(), ROBOT, files)["seen_in_training"] == []


def test_runs_of_one_name_in_several_folders_stay_apart(tmp_path):
    files = []
    for k, day in enumerate(["monday", "tuesday"]):
        folder = tmp_path / day / "new"
        folder.mkdir(parents=True)
        files.append(drive(folder, "run_01.csv", y=3.0 + k))
    files.append(drive(tmp_path, "run_02.csv", y=5.0))
    names = ["monday/new/run_01.csv", "tuesday/new/run_01.csv", "run_02.csv"]
    found = evaluate_on_runs(find_predictor("physics"), waves(), ROBOT, files)
    assert list(found["route_relative_errors"]) == names
    assert found["route_relative_error"] == pytest.approx(np.mean(list(found["route_relative_errors"].values())))
    site = Site(waves(), tuple(files[:1]), ROBOT, tuple(files[1:2]), tuple(files[2:]))
    with_base = read_calibration_runs([site]).sites[0]
    parts = with_base.new, with_base.baseline, with_base.test
    assert [part.runs for part in parts] == [(name,) for name in names]
