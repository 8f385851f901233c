"""Runs in Parquet: the same run as in CSV, with the same rules and counts, and what cannot be read is refused."""

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

from joulemap.model.errors import RunsError
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.service.commands.options import find_runs


def columns(n=60):
    t = 0.1 * np.arange(n)
    t[31] = t[30]  # a repeated stamp
    current = np.full(n, 2.0)
    current[40] = 90.0  # a spike
    return {
        "t": t,
        "x": np.full(n, 10.0),
        "y": 0.05 * np.arange(n),
        "voltage": np.full(n, 28.0),
        "current": current,
        "wind_speed": np.full(n, np.nan),
        "lidar": np.arange(n),
        "terrain": np.array(["grass", "gravel"])[np.arange(n) // 40],
    }


def parquet(table) -> bytes:
    out = io.BytesIO()
    pq.write_table(pa.table(table), out)
    return out.getvalue()


def csv(table) -> str:
    def cell(value):
        return value if isinstance(value, str) else "" if np.isnan(value) else repr(float(value))

    rows = [",".join(map(cell, row)) for row in zip(*(v.tolist() for v in table.values()), strict=True)]
    return "\n".join([",".join(table), *rows])


def same(a, b):
    assert a.repairs == b.repairs
    for key in ("t", "x", "y", "current_a", "voltage_v", "breaks"):
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
    assert a.extras.keys() == b.extras.keys()
    for key, values in a.extras.items():
        np.testing.assert_array_equal(values, b.extras[key])
    assert a.texts.keys() == b.texts.keys()
    for key, words in a.texts.items():
        np.testing.assert_array_equal(words, b.texts[key])


def test_parquet_is_read_as_the_same_csv(tmp_path):
    (tmp_path / "run.parquet").write_bytes(parquet(columns()))
    run = read_run(tmp_path / "run.parquet")
    assert run.repairs == {"duplicate_stamps": 1, "current_spikes": 1}
    same(run, parse_run(csv(columns()), name="run.csv"))


def test_nulls_categories_times_and_small_numbers_mean_the_same():
    plain = columns()
    stamps = pa.array((plain["t"] * 1e9).round().astype(np.int64)).cast(pa.timestamp("ns"))
    wind = pa.array([None] * 60, pa.float32())
    words = pa.array(plain["terrain"]).dictionary_encode()
    lidar = pa.array(plain["lidar"], pa.int16())
    typed = parquet({**plain, "t": stamps, "wind_speed": wind, "terrain": words, "lidar": lidar})
    run = parse_run(typed, name="run.parquet")
    np.testing.assert_allclose(run.t, parse_run(parquet(plain), name="run.parquet").t, atol=1e-9)
    assert np.isnan(run.extras["wind_speed"]).all()
    assert run.texts["terrain"][-1] == "gravel"
    assert run.extras["lidar"][-1] == 59.0


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_fields_of_structures_are_columns(kind):
    plain = columns()
    position = pa.StructArray.from_arrays([pa.array(plain["x"]), pa.array(plain["y"])], ["x", "y"])
    frame = pa.array(["map"] * 60)
    beams = pa.array([[1.0, 2.0]] * 60)
    mask = pa.array(np.arange(60) == 50)  # a message that is missing
    battery = pa.StructArray.from_arrays(
        [pa.array(1e3 * plain["voltage"]), pa.array(1e3 * plain["current"]), pa.array(["A"] * 60)],
        ["bus_mv", "bus_ma", "pack"],
        mask=mask,
    )
    table = pa.table(
        {
            "t": plain["t"],
            "pose": pa.StructArray.from_arrays([position, frame, beams], ["position", "frame", "beams"]),
            "power": battery,
        }
    )
    out = io.BytesIO()
    if kind == "feather":
        feather.write_feather(table, out)
    else:
        pq.write_table(table, out)
    said = {"voltage": "power.bus_mv:mV", "current": "power.bus_ma:mA"}
    run = parse_run(out.getvalue(), name="run", mapping=said)
    assert run.repairs == {"duplicate_stamps": 1, "current_spikes": 1, "blank_voltage": 1, "blank_current": 1}
    same_run = parse_run(parquet(plain), name="run")
    for key in ("t", "x", "y", "current_a", "voltage_v"):
        np.testing.assert_allclose(getattr(run, key), getattr(same_run, key), atol=1e-9)
    assert run.texts["power.pack"][0] == "A"
    assert "pose.beams" not in run.extras


def test_what_is_no_run_is_refused_with_its_place():
    with pytest.raises(RunsError, match="not a readable Parquet file"):
        parse_run(b"PAR1" + b"\0" * 40, name="run.parquet")
    words = columns() | {"current": np.array(["much"] * 60)}
    with pytest.raises(RunsError, match="column 'current', row 2: 'much' is not a number"):
        parse_run(parquet(words), name="run.parquet")
    words = pa.DictionaryArray.from_arrays(np.repeat([0, 1, 3], 20), ["grass", "gravel", "sand"], safe=False)
    with pytest.raises(RunsError, match=r"not a readable Parquet file: .*out of bounds: 3"):
        parse_run(parquet({**columns(), "terrain": words}), name="run.parquet")
    with pytest.raises(RunsError, match="3 rows are too few"):
        parse_run(parquet({key: values[:3] for key, values in columns().items()}), name="run.parquet")


def test_a_folder_of_runs_holds_both_kinds(tmp_path):
    (tmp_path / "a.parquet").write_bytes(parquet(columns()))
    (tmp_path / "b.csv").write_text(csv(columns()))
    (tmp_path / "robot.toml").write_text("")
    assert [file.name for file in find_runs([str(tmp_path)])] == ["a.parquet", "b.csv"]
