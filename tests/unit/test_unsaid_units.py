"""Units that no name gives follow from the other columns, and contradictions are reported, on one drive in variants."""

import io
import json

import numpy as np
import pyarrow as pa
import pytest

import joulemap as jm
from joulemap.model.errors import RunsError

T = np.arange(0.0, 600.0)
V = 8.0 + 2.0 * np.sin(T / 20.0) + np.sin(T / 7.0)  # [m/s]
V[300:330] = 0.0
S = np.concatenate([[0.0], np.cumsum(0.5 * (V[1:] + V[:-1]))])
W = 40.0 + 60.0 * 9.81 * 0.03 * V
DEGREES = {"lat": 48.0 + S / 111_200.0, "lon": np.full(T.size, 11.0)}
JOULES = float(np.sum(0.5 * (W[1:] + W[:-1])))


def read(columns, **more):
    return jm.read_runs(columns, crs="EPSG:32632", **more).runs[0]


def as_it_was(run):
    known = np.isfinite(run.x)
    assert np.hypot(np.diff(run.x[known]), np.diff(run.y[known])).sum() == pytest.approx(S[-1], rel=0.01)
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.01)


@pytest.mark.parametrize(("speed", "way"), [(3.6, 1e-3), (1.0, 1.0), (3.6, 1.0)])
def test_clock_speed_and_odometer_tell_each_other_their_units(speed, way):
    run = read({"Time": 1000 * T, "Speed": speed * V, "Odometer": 4200 + way * S, "power [W]": W})
    as_it_was(run)
    assert run.reading["t"] == "Time [ms]"


def test_volts_amperes_and_kilowatts_tell_each_other_their_units():
    run = read(DEGREES | {"t": T, "Pack U": np.full(T.size, 48_000.0), "Pack I": W / 0.048, "Pack power": W / 1000})
    as_it_was(run)


def test_a_speed_in_no_unit_of_the_way_is_left_out_and_a_contradiction_is_said():
    assert "speed" not in read(DEGREES | {"t": T, "speed": V / 0.5144, "power": W}).extras  # knots
    (said,) = read(DEGREES | {"t": T, "speed [km/h]": V, "power [W]": W}).notes
    assert said.startswith("its speed is 0.278 times that of its positions")


def test_a_power_that_does_not_follow_the_movement_is_asked_for_or_said():
    with pytest.raises(RunsError, match=r"voltage=attributes\.power:V"):
        read(DEGREES | {"t": T, "speed_mps": V, "attributes.power": np.full(T.size, 37.9), "current": W / 37.9})
    run = read(DEGREES | {"t": T, "speed_mps": V, "power_w": np.full(T.size, 250.0)})
    assert any("as large at rest as while driving" in note for note in run.notes)
    blank = read(
        DEGREES | {"t": T, "power": np.full(T.size, np.nan), "voltage": np.full(T.size, 48.0), "current": W / 48}
    )
    as_it_was(blank)


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_rows_of_two_vehicles_are_said(late):
    columns = DEGREES | {"t": T, "voltage": np.full(T.size, 48.0), "current": W / 48}
    other = columns | {"lat": DEGREES["lat"] + 0.05, "t": T + late}
    run = read({key: np.stack([columns[key], other[key]], axis=1).ravel() for key in columns})
    assert any("is it one vehicle" in note for note in run.notes)
    assert any("positions alternate" in note for note in run.notes) == (late > 0.0)
    copies = read({key: np.repeat(values, 2) for key, values in columns.items()})
    assert not any("is it one vehicle" in note for note in copies.notes)


def test_feather_deltas_of_a_ship_and_lines_of_a_service_are_read(tmp_path):
    columns = DEGREES | {"t": T, "power_w": W}
    out = io.BytesIO()
    with pa.ipc.new_file(out, (table := pa.table(columns)).schema) as file:
        file.write_table(table)
    (tmp_path / "a.feather").write_bytes(out.getvalue())
    as_it_was(read(tmp_path / "a.feather"))
    (tmp_path / "a.feather").write_bytes(out.getvalue()[:-40])
    with pytest.raises(RunsError, match="not a readable Feather file"):
        read(tmp_path / "a.feather")
    stamps = [f"2026-03-14T09:{k // 60:02d}:{k % 60:02d}.000Z" for k in range(T.size)]
    place, flow = {"label": "gps", "type": "NMEA0183"}, {"label": "n2k", "type": "NMEA2000"}
    deltas = [
        {"updates": [{"source": source, "timestamp": stamp, "values": values}]}
        for stamp, lat, power in zip(stamps, DEGREES["lat"].tolist(), W.tolist(), strict=True)
        for source, values in (
            (place, [{"path": "navigation.position", "value": {"longitude": 11.0, "latitude": lat}}]),
            (flow, [{"path": "electrical.batteries.1.power", "value": power}]),
        )
    ]
    (tmp_path / "a.log").write_text("".join(json.dumps(each) + "\n" for each in deltas))
    as_it_was(read(tmp_path / "a.log"))
    lines = zip(stamps, DEGREES["lat"], W, strict=True)
    (tmp_path / "b.log").write_text(
        "".join(f"ts={stamp} level=info msg=x lat={lat:.7f} lon=11.0 power={w:.3f}\n" for stamp, lat, w in lines)
    )
    as_it_was(read(tmp_path / "b.log"))
