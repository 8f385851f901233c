"""Logs of other programs over HTTP, on the command line and in Python: mapped, judged, kept in joulemap's columns."""

import json
from functools import cache

import numpy as np
import pytest
import rasterio
from fastapi.testclient import TestClient
from rasterio.transform import Affine
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.reader import read_run
from joulemap.service.cli import app
from joulemap.service.http.app import create_app
from joulemap.service.intake.limits import ReadLimits
from joulemap.service.intake.trial import refuse_deadly
from joulemap.service.library import run_files
from tests.reference import log_files as files
from tests.service.conftest import WEST, settings_for
from tests.unit import test_logs_of_tools as logs_of_tools
from tests.unit.test_recordings import archive_of, split_bag

ROWS = 300


def odd_csv(**replaced):
    k = np.arange(ROWS)
    columns = {
        "timestamp_ms": 1_700_000_000_000 + 100 * k,
        "pos_x": np.round(WEST + 0.05 * k, 3),
        "pos_y": np.full(ROWS, 4_000_015.0),
        "pack_mV": np.full(ROWS, 24_000),
        "batt_current_mA": -(2_000 + 10 * (k % 7)),
    } | replaced
    lines = [";".join(map(str, row)).replace(".", ",") for row in zip(*columns.values(), strict=True)]
    return "\n".join([";".join(columns), *lines]) + "\n"


MAP = ["voltage=pack_mV", "x=pos_x:m,y=pos_y:m"]


def test_what_is_sent_is_kept_in_joulemaps_columns_and_the_answer_says_from_where(client, heightmap_id):
    query = {"heightmap_id": heightmap_id, "map": MAP}
    answer = client.post("/v1/runs", files={"file": ("odd.csv", odd_csv())}, params=query)
    assert answer.status_code == 201, answer.text
    (run,) = answer.json()["runs"]
    assert run["reading"] == {
        "t": "timestamp_ms [ms]",
        "x": "pos_x [m]",
        "y": "pos_y [m]",
        "voltage": "pack_mV [mV]",
        "current": "batt_current_mA [mA]",
    }
    assert run["format"] == "CSV text"
    assert run["repairs"] == {"current_sign_flipped": 1}
    assert run["per_m"] == pytest.approx(24.0 * 2.03 / 0.5, rel=0.01)
    (kept,) = client.app.state.service.store.run_files(answer.json()["id"])
    assert kept.read_text().splitlines()[0] == "t,x,y,voltage,current"


def test_implausible_runs_are_not_kept_unless_they_are_accepted(client, heightmap_id):
    query = {"heightmap_id": heightmap_id, "map": [*MAP, "current=batt_current_mA:A"]}
    files = {"file": ("odd.csv", odd_csv())}
    uploads = client.app.state.service.settings.data_dir / "uploads"
    before, lying = client.get("/v1/runs").json()["total"], sorted(uploads.rglob("*"))
    answer = client.post("/v1/runs", files=files, params=query)
    assert answer.status_code == 422, answer.text
    assert "is `current` in mA?" in answer.json()["detail"]
    assert client.get("/v1/runs").json()["total"] == before
    assert sorted(uploads.rglob("*")) == lying
    accepted = client.post("/v1/runs", files=files, params=query | {"accept_implausible": True})
    assert accepted.status_code == 201, accepted.text
    turned, implausible, *_ = accepted.json()["runs"][0]["warnings"]
    assert "`current` is negative in most rows, so its sign is changed" in turned
    assert "2,030 A at 24.0 V" in implausible


def test_a_mapping_that_cannot_be_is_refused_over_http(client):
    for entry, words in (("current=amps", "no column of it"), ("current", "no entry"), ("1x=a", "no name of a column")):
        answer = client.post("/v1/runs", files={"file": ("odd.csv", odd_csv())}, params={"map": entry})
        assert answer.status_code == 422, answer.text
        assert words in answer.json()["detail"]


def test_import_writes_all_logs_or_none(tmp_path):
    (tmp_path / "a.csv").write_text(odd_csv())
    (tmp_path / "b.csv").write_text(odd_csv(pack_mV=np.full(ROWS, 24)))
    command = ["import", str(tmp_path / "a.csv"), "--map", ",".join(MAP), "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(app, [*command, "--json", str(tmp_path / "answer.json")])
    assert found.exit_code == 0, found.output
    assert "from batt_current_mA [mA]" in found.output
    (run,) = json.loads((tmp_path / "answer.json").read_text())["runs"]
    assert run["out"] == str(tmp_path / "out" / "a.csv")
    again = CliRunner().invoke(app, command)
    assert again.exit_code == 6
    both = ["import", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"), "--map", ",".join(MAP)]
    refused = CliRunner().invoke(app, [*both, "--out", str(tmp_path / "none")])
    assert refused.exit_code == 3, refused.output
    assert "b.csv is implausible: its voltage is 0.024 V" in refused.output
    assert list((tmp_path / "none").iterdir()) == []
    runs = jm.read_runs(tmp_path / "out" / "a.csv")
    np.testing.assert_allclose(runs.runs[0].voltage_v, 24.0)
    assert runs.reading == {}


def test_a_python_user_gives_a_mapping_and_is_warned(tmp_path):
    (tmp_path / "a.csv").write_text(odd_csv())
    runs = jm.read_runs(tmp_path / "a.csv", mapping=MAP)
    assert runs.reading["a.csv"]["voltage"] == "pack_mV [mV]"
    with pytest.warns(UserWarning, match="2,030 A at 24.0 V"):
        jm.read_runs(
            tmp_path / "a.csv",
            mapping={"voltage": "pack_mV", "x": "pos_x", "y": "pos_y", "current": "batt_current_mA:A"},
        )
    with pytest.raises(RunsError, match="near it are batt_current_mA"):
        jm.read_runs(tmp_path / "a.csv", mapping={"current": "batt_current"})


def test_a_map_in_degrees_is_reprojected_on_request(client):
    second = 1 / 3600
    row, col = np.mgrid[0:40, 0:50]
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=50,
            height=40,
            count=1,
            dtype="float32",
            crs="EPSG:4326",
            transform=Affine(second, 0, -4.5, 0, -second, 36.74),
        ) as dataset:
            dataset.write((50 + 0.3 * row + 0.1 * col).astype(np.float32), 1)
        content = bytes(memory.getbuffer())
    refused = client.post("/v1/heightmaps", files={"file": ("dem.tif", content)})
    assert refused.status_code == 422
    assert "give `reproject` as auto" in refused.json()["detail"]
    kept = client.post("/v1/heightmaps", files={"file": ("dem.tif", content)}, params={"reproject": "auto"})
    assert kept.status_code == 201, kept.text
    assert kept.json()["crs"] == "EPSG:32630"
    assert kept.json()["notes"][0].startswith("reprojected from EPSG:4326 to EPSG:32630 (UTM zone 30N)")


def test_a_recording_is_kept_as_a_table(client, tmp_path):
    before = client.get("/v1/runs").json()["total"]
    content = files.write_mcap(tmp_path / "drive.mcap", files.drive(40.0)).read_bytes()
    query = {"map": ["x=/odom.pose.pose.position.x", "y=/odom.pose.pose.position.y"]}
    answer = client.post("/v1/runs", files={"file": ("drive.mcap", content)}, params=query)
    assert answer.status_code == 201, answer.text
    (run,) = answer.json()["runs"]
    assert (run["format"], run["name"]) == ("MCAP recording", "drive.mcap")
    assert run["reading"]["current"] == "/battery_state.current [A]"
    (kept,) = client.app.state.service.store.run_files(answer.json()["id"])
    assert kept.read_text().startswith("t,x,y,z,voltage,current")
    cut = client.post("/v1/runs", files={"file": ("drive.mcap", content[:20_000])}, params=query)
    assert cut.status_code == 201
    assert "ends in the middle of a record that begins at byte" in cut.json()["runs"][0]["warnings"][0]
    assert cut.json()["runs"][0]["rows"] < run["rows"]
    corrupt = content[:9_000] + b"\0" * 400 + content[9_400:]
    refused = client.post("/v1/runs", files={"file": ("drive.mcap", corrupt)}, params=query)
    assert refused.status_code == 422
    assert "truncated or corrupt after" in refused.json()["detail"]
    assert client.get("/v1/runs").json()["total"] == before + 2


def test_a_bag_of_several_files_is_sent_as_an_archive(client, tmp_path):
    content = archive_of(split_bag(tmp_path / "monday", files.drive(40.0), ".db3"), "zip")
    query = {"map": ["x=/odom.pose.pose.position.x", "y=/odom.pose.pose.position.y"]}
    answer = client.post("/v1/runs", files={"file": ("monday.zip", content)}, params=query)
    assert answer.status_code == 201, answer.text
    (run,) = answer.json()["runs"]
    assert (run["format"], run["rows"]) == ("ROS 2 bag of several files", 401)


def test_files_of_messages_are_read_on_trial_within_limits(tmp_path):
    good = files.write_mcap(tmp_path / "a.mcap", files.drive(20.0))
    refuse_deadly([good])
    with pytest.raises((RunsError, TooLargeError), match=r"run a\.mcap: the MCAP recording .* after 0 messages"):
        refuse_deadly([good], limits=ReadLimits(100.0, 1.0))
    with pytest.raises(TooLargeError, match=r"run a\.mcap: it could not be read within 0\.001 s"):
        refuse_deadly([good], limits=ReadLimits(0.001, 4_000.0))
    good.write_bytes(good.read_bytes()[:9_000] + b"\0" * 400 + good.read_bytes()[9_400:])
    with pytest.raises(RunsError, match=r"run a\.mcap: the MCAP recording is truncated or corrupt"):
        jm.read_runs(good, crs=files.CRS)


def in_memory():
    k = np.arange(ROWS)
    return {
        "timestamp": 0.1 * k,
        "x": WEST + 0.05 * k,
        "y": 0.0 * k,
        "Pack Volts": 24.0 + 0.0 * k,
        "amps": 2.0 + 0.01 * (k % 7),
    }


def test_tables_in_memory_are_runs_as_files_are(tmp_path):
    import pandas as pd
    import pyarrow as pa

    columns = in_memory()
    frame = pd.DataFrame(columns)
    timed = frame.drop(columns="timestamp").set_index(pd.to_datetime(1e9 * columns["timestamp"], utc=True))
    more = [columns, {key: list(values) for key, values in columns.items()}, frame, timed, pa.table(columns)]
    energies = [jm.read_runs(one).runs[0].energy()[0] for one in more]
    assert energies == pytest.approx([energies[0]] * len(more))
    runs = jm.read_runs(one | {"amps": one["amps"] + k} for k, one in enumerate([columns, columns]))
    assert [len(run) for run in runs.runs] == [ROWS, ROWS]
    with pytest.raises(RunsError, match="not a readable table"):
        jm.read_runs({"t": [1, 2, 3], "x": [1]})
    with pytest.raises(RunsError, match="speed=Speed:km/h"):
        jm.read_runs({"t": columns["timestamp"], "Speed": np.full(ROWS, 5.0), "power": np.full(ROWS, 90.0)})


def test_copies_of_a_log_are_one_run(client, tmp_path):
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.csv").write_text(odd_csv())
    with pytest.warns(UserWarning, match=r"a\.csv is there 3 times, also as b\.csv, c\.csv: it is read once"):
        assert len(jm.read_runs(tmp_path, mapping=MAP)) == 1
    found = CliRunner().invoke(
        app, ["import", str(tmp_path), "--map", ",".join(MAP), "--picture", str(tmp_path / "a.png")]
    )
    assert found.exit_code == 0, found.output
    assert "a.csv is there 3 times" in found.output
    assert "pack_mV" in found.output
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    sent = [("file", (name, odd_csv())) for name in ("a.csv", "b.csv")]
    answer = client.post("/v1/runs", files=sent, params={"map": MAP})
    assert answer.status_code == 201, answer.text
    (run,) = answer.json()["runs"]
    assert run["warnings"][-1] == "it was sent again as b.csv: it is kept once"
    assert run["first_rows"]["voltage"] == [24.0] * 5
    assert run["confidence"]["voltage"] == 1.0
    assert run["energy_j"] == pytest.approx(run["per_m"] * run["metres"], rel=0.02)


def test_a_yaw_of_unknown_zero_takes_turns_out_that_never_happened(tmp_path):
    """Imported on the command line: a straight drive with scattered positions, and the yaw of an IMU."""
    north = 4_000_015.0 + 0.15 * np.random.default_rng(0).standard_normal(ROWS)
    bearing = np.round(200.0 + 0.2 * np.random.default_rng(1).standard_normal(ROWS), 2)
    turned = []
    for name, columns in (("without", {}), ("with", {"yaw": bearing})):
        (tmp_path / f"{name}.csv").write_text(odd_csv(pos_y=np.round(north, 3), **columns))
        mapped = [part for value in MAP for part in ("--map", value)]
        answer = CliRunner().invoke(
            app, ["import", str(tmp_path / f"{name}.csv"), *mapped, "--out", str(tmp_path / f"{name}_kept")]
        )
        assert answer.exit_code == 0, answer.output
        turned.append(cut_segments(read_run(next((tmp_path / f"{name}_kept").glob("*.csv")))).turned_abs_rad.sum())
    assert turned[1] < 0.3 < turned[0]


def test_a_state_of_charge_has_the_metres_of_a_smoothed_track(tmp_path):
    k, scatter = np.arange(982), np.random.default_rng(1).normal(0.0, 0.1, (2, 982))
    rows = np.column_stack([k / 5, 5e5 + 0.16 * k + scatter[0], 4e6 + scatter[1], 90.0 - 0.01 * (k // 10)])
    np.savetxt(tmp_path / "r.csv", rows, "%.3f", ",", header="t,x,y,soc_percent", comments="")
    command = ["import", str(tmp_path / "r.csv"), "--map", "capacity_wh=50", "--json", str(tmp_path / "answer.json")]
    assert CliRunner().invoke(app, command).exit_code == 0
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["runs"][0]["metres"] == pytest.approx(0.16 * 981, rel=0.02)


def test_a_table_in_memory_outlives_a_service_of_the_same_process(tmp_path, monkeypatch):
    monkeypatch.setattr(run_files, "_folder", cache(run_files._folder.__wrapped__))
    with TestClient(create_app(settings_for(tmp_path))):
        runs = jm.read_runs(in_memory())
    assert all(file.is_file() for file in runs.files)
    assert len(jm.read_runs(in_memory())) == 1


@pytest.mark.parametrize(
    "shape", ["NMEA: the battery as transducers", "InfluxDB's export, with its preamble and another voltage"]
)
def test_logs_of_lines_through_the_command(tmp_path, shape):
    path = tmp_path / "drive.log"
    path.write_text(logs_of_tools.SHAPES[shape], encoding="utf-8", newline="")
    done = CliRunner().invoke(app, ["import", str(path), "--out", str(tmp_path / "out"), "--json", "-"])
    assert done.exit_code == 0, done.output
    (imported,) = json.loads(done.stdout)["runs"]
    assert imported["metres"] == pytest.approx(logs_of_tools.S[-1], rel=0.01)
    assert (tmp_path / "out" / "drive.csv").is_file()
    assert imported["energy_j"] == pytest.approx(logs_of_tools.JOULES, rel=0.01)


def test_an_archive_lies_where_its_bounds_say_through_the_command_and_over_http(tmp_path, client):
    heights = np.add.outer(np.arange(40.0), np.zeros(60)) / 10.0
    np.savez(tmp_path / "hill.npz", elevation=heights, bounds=[500_000.0, 4_000_000.0, 500_060.0, 4_000_040.0])
    done = CliRunner().invoke(app, ["info", str(tmp_path / "hill.npz"), "--json", "-"])
    assert done.exit_code == 0, done.output
    answer = client.post("/v1/heightmaps", files={"file": ("hill.npz", (tmp_path / "hill.npz").read_bytes())})
    assert answer.status_code == 201, answer.text
    for said in (json.loads(done.stdout), answer.json()):
        assert said["bounds"] == [500_000.0, 4_000_000.0, 500_060.0, 4_000_040.0]
