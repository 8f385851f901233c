"""Logs that are not what they seem: signs, clocks, frozen positions, arrays of objects, copies, units."""

import zipfile

import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import InputError, RunsError
from joulemap.service.cli import app

T = np.arange(0.0, 600.0)
V = 8.0 + 2.0 * np.sin(T / 20.0) + np.sin(T / 7.0)  # down a slope of 5 %, with regeneration [m/s]
S = np.cumsum(V)
DRAWN = 60.0 * 9.81 * (0.02 - 0.05) * V + 25.0 + 60.0 * np.gradient(V) * V  # [W], negative in sum
LEVEL = 60.0 * 9.81 * 0.03 * V + 25.0 + 60.0 * np.gradient(V) * V
PLACE = {"t": T, "x": 0.0 * T, "y": S}


def csv(columns):
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(f"{value:.4f}" for value in row) for row in rows)]) + "\n"


def written(tmp_path, columns, name="a.csv"):
    (tmp_path / name).write_text(csv(columns))
    return str(tmp_path / name)


def imported(*arguments):
    found = CliRunner().invoke(app, ["import", *arguments], env={"COLUMNS": "400"})
    return found.exit_code, " ".join(found.output.split())


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    "more",
    [
        {"voltage": 48.0 - 0.05 * DRAWN / 48.0, "current": DRAWN / 48.0},
        {"speed": V, "power": DRAWN},
        {"power": DRAWN},
    ],
)
def test_a_run_that_charges_in_sum_keeps_its_sign_and_says_so(tmp_path, sign, more):
    flow = [*more][-1]
    code, said = imported(written(tmp_path, PLACE | more | {flow: sign * more[flow]}))
    assert code == 0, said
    assert f"in most rows its `{flow}` charges the battery" in said
    with pytest.warns(UserWarning, match="charges the battery"):
        run = jm.read_runs(tmp_path / "a.csv").runs[0]
    assert run.energy()[0] == pytest.approx(np.trapezoid(DRAWN, T), rel=0.02)


def test_a_sign_that_nothing_shows_is_said_by_a_mapping_and_kept_with_the_file(tmp_path):
    seldom = {"t": T, "x": 0.0 * T, "y": 8.0 * T, "power": np.full(T.size, -80.0)}
    file = written(tmp_path, seldom)
    code, said = imported(file)
    assert code == 0, said
    assert "say so with a mapping: power=+" in said
    code, said = imported(file, "--map", "power=+power", "--out", str(tmp_path / "out"))
    assert code == 0, said
    for again in (jm.read_runs(tmp_path / "out" / "a.csv"), jm.read_runs(file, mapping={"power": "+power"})):
        assert again.runs[0].energy()[0] == pytest.approx(-80.0 * 599.0)


@pytest.mark.parametrize(("drift", "words"), [(0.0, "changed by about -1"), (0.02, " s at last: were")])
def test_tables_whose_clocks_differ_are_not_joined_without_a_word(tmp_path, drift, words):
    t = np.arange(0.0, 1800.0)
    turns = np.random.default_rng(55).normal(size=t.size + 200)
    v = 8.0 + np.convolve(turns, np.hanning(12) / 1.5, "same")[100:-100]
    drawn = 60.0 * 9.81 * 0.03 * v + 25.0 + 60.0 * np.gradient(v) * v
    for late in (False, True):
        stamps = t - (120.0 + drift * t if late else 0.0)
        with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
            archive.writestr("gps.csv", csv({"t": t, "x": 0.0 * t, "y": np.cumsum(v)}))
            archive.writestr("battery.csv", csv({"t": stamps, "power": drawn}))
        code, said = imported(str(tmp_path / "two.zip"))
        assert code == 0, said
        assert ("goes with its movement only where its clock is changed" in said) == late, said
    assert words in said


@pytest.mark.parametrize("going_on", [{"speed": V}, {"odometer [m]": 4711.0 + S}])
def test_positions_that_freeze_half_way_are_said_and_not_used(tmp_path, going_on):
    stuck = PLACE | {"y": np.minimum(S, S[300]), "power": LEVEL} | going_on
    code, said = imported(written(tmp_path, stuck))
    assert code == 0, said
    assert "its positions stay the same for 299 s" in said
    stopped = PLACE | {"y": np.cumsum(np.where(T > 300, 0.0, V)), "power": LEVEL, "speed": np.where(T > 300, 0.0, V)}
    assert "stay the same" not in imported(written(tmp_path, stopped))[1]


def test_numbers_in_arrays_of_objects_are_read_or_named(tmp_path):
    import pandas as pd

    objects = np.array([np.array([value]) for value in LEVEL] + [None], dtype=object)[:-1]
    columns = PLACE | {"power": objects}
    for table in (columns, pd.DataFrame(columns)):
        assert jm.read_runs(table).runs[0].energy()[0] == pytest.approx(np.trapezoid(LEVEL, T), rel=0.01)
    np.savez(tmp_path / "a.npz", **columns)
    code, said = imported(str(tmp_path / "a.npz"))
    assert code != 0
    assert "power holds objects of Python" in said
    np.savez(tmp_path / "b.npz", **PLACE, power=LEVEL, remark=objects)
    code, said = imported(str(tmp_path / "b.npz"))
    assert code == 0, said
    assert "remark holds objects of Python" in said


def test_runs_are_no_baseline_of_themselves(tmp_path, client):
    rover = jm.Robot(mass_kg=60.0, speed_mps=8.0)
    files = [written(tmp_path, {"t": T, "distance": S, "power": LEVEL + k}, f"{k}.csv") for k in range(2)]
    (tmp_path / "copy.csv").write_text((tmp_path / "0.csv").read_text())
    for baseline in (files[:1], [str(tmp_path / "copy.csv")]):
        with pytest.raises(InputError, match="is a run to learn from and a baseline run"):
            jm.calibrate(runs=files, baseline_runs=baseline, robot=rover, out=tmp_path / "new")
    runs = ["r1"]
    asked = client.post("/v1/calibrations", json={"runs": runs, "baseline_runs": runs, "robot": rover.as_dict()})
    assert asked.status_code == 422, asked.text
    assert "name earlier runs as baseline" in asked.text


def test_a_distance_in_no_unit_is_asked_for_where_no_vehicle_drives_so_many_metres(tmp_path):
    for factor, unit in ((1.0 / 0.3048, "ft"), (0.001, "km")):
        file = written(tmp_path, {"t": T, "odometer": factor * S, "power": LEVEL})
        code, said = imported(file)
        assert code != 0
        assert f"distance=odometer:{unit}" in said
        assert "odometer:m/row" in said
        code, said = imported(file, "--map", f"distance=odometer:{unit}")
        assert code == 0, said


def test_a_column_of_what_came_since_the_row_before_is_hinted_at():
    each = {"t": T, "speed [m/s]": V, "energy_wh": LEVEL / 3600.0}
    with pytest.raises(RunsError, match="energy=energy_wh:Wh/row"):
        jm.read_runs(each)
    run = jm.read_runs(each, mapping={"energy": "energy_wh:Wh/row"}).runs[0]
    assert run.energy()[0] == pytest.approx(LEVEL.sum(), rel=0.01)
    with pytest.raises(RunsError, match="each with /row where a row says what came since"):
        jm.read_runs(each, mapping={"energy": "energy_wh:m"})


def test_a_coarse_counter_does_not_choose_between_units_of_speed():
    t = np.arange(0.0, 4.0, 0.2)
    columns = {"t": t, "speed": np.full(t.size, 4.0), "distance": np.floor(4.0 / 3.6 * t + 1.5), "power": 50.0 + t}
    run = jm.read_runs(columns).runs[0]
    assert "speed" not in run.reading
    assert run.y[-1] - run.y[0] == 4.0
