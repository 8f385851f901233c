"""Logs in the shapes that people have: small cases of each kind, and the files of `shared/wild` with their answers."""

import gzip
import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import InputError, RunsError, TooLargeError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.names import LIKELY, NAMED, candidate
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.model.runs.without_map import ground_of_profile
from joulemap.service.cli import app

ROWS = 400
T = 0.5 * np.arange(ROWS)
X = 500_000 + np.cumsum(np.full(ROWS, 0.9))
VOLTS = 25.0 + 0.1 * np.sin(T / 40)
AMPS = 3.0 + np.sin(T / 15)
JOULES = float(np.sum(0.5 * (VOLTS[1:] * AMPS[1:] + VOLTS[:-1] * AMPS[:-1]) * np.diff(T)))
LEFT = np.append(0.0, np.cumsum(0.5 * (VOLTS[1:] * AMPS[1:] + VOLTS[:-1] * AMPS[:-1]) * np.diff(T))) / 3600  # Wh
METRES = float(X[-1] - X[0])
PLAIN = {"t": T, "x": X, "y": np.full(ROWS, 4e6), "voltage": VOLTS, "current": AMPS}


def lines(columns, separator=",", digits=6):
    def _cell(value):
        return value if isinstance(value, str) else "" if np.isnan(value) else f"{value:.{digits}f}".rstrip("0")

    return [separator.join(columns), *(separator.join(map(_cell, row)) for row in zip(*columns.values(), strict=True))]


def read(columns, crs=None, mapping=None, **more):
    return parse_run("\n".join(lines(columns, **more)) + "\n", name="r", crs=crs, mapping=mapping)


def without(*names, **more):
    return {key: values for key, values in PLAIN.items() if key not in names} | more


def as_it_was(run, *, share=0.01):
    assert run.energy()[0] == pytest.approx(JOULES, rel=share)
    known = np.isfinite(run.x)
    assert np.hypot(np.diff(run.x[known]), np.diff(run.y[known])).sum() == pytest.approx(METRES, rel=share)


FAULTS = {
    "a row of units": lambda text: [text[0], "s,m,m,V,A", *text[1:]],
    "names twice": lambda text: [f"{text[0]},note,note", *(f"{line},a,b" for line in text[1:])],
    "nameless columns": lambda text: [f"{line},," for line in text],
    "longer rows": lambda text: [line + (",x" if k % 50 == 7 else "") for k, line in enumerate(text)],
    "two logs joined": lambda text: [*text[:200], text[0], *text[200:]],
    "remarks before the header": lambda text: ["Logger 1.2", "serial,AB12", *text],
    "a header in a comment": lambda text: [f"# {text[0]}", *text[1:]],
    "spaces between": lambda text: [line.replace(",", "  ") for line in text],
    "bars between": lambda text: [line.replace(",", "|") for line in text],
    "words before numbers": lambda text: [
        f"{text[0]},a,b,c,d,e,f",
        *(f"{line},eco,1,auto,2,on,3" for line in text[1:]),
    ],
    "marks for what is missing": lambda text: [*text[:100], "N/A,null,NA,--,?", *text[100:]],
    "units in the cells": lambda text: [text[0], *(line + " A" for line in text[1:])],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_does_not_matter_refuses_no_file(fault):
    as_it_was(parse_run("\n".join(FAULTS[fault](lines(PLAIN))) + "\n", name="r"))


def test_topics_of_different_rates_are_series_of_their_own():
    place, meter = np.arange(ROWS) % 2 == 0, np.arange(ROWS) % 5 == 1
    columns = {key: np.where(meter if key in ("voltage", "current") else place, v, np.nan) for key, v in PLAIN.items()}
    as_it_was(read(columns | {"t": T}), share=0.02)


def test_numbers_that_mark_what_is_unknown_are_no_readings():
    power = np.where(np.arange(ROWS) % 9 == 0, 65535.0, VOLTS * AMPS)
    run = read(without("voltage", "current", power=power))
    assert run.repairs["marks_power"] == 45
    as_it_was(run)
    wrapped = np.where((T > 50) & (T < 60), 327.67, AMPS)
    run = read(without("current", current=wrapped))
    assert run.unknown_s == pytest.approx(9.5)
    as_it_was(run, share=0.02)
    with pytest.raises(RunsError, match="power is 65535 in every row, the mark of an unknown value"):
        read(without("voltage", "current", power=np.full(ROWS, 65535.0)))
    read(without("current", current=np.where(T < 100, 255.0, 250.0)))  # readings beside it: no mark


def test_counters_give_power_across_their_new_beginnings():
    energy = np.concatenate([[0.0], np.cumsum(0.5 * (VOLTS * AMPS)[1:] + 0.5 * (VOLTS * AMPS)[:-1])]) * 0.5 / 3600
    anew = energy - np.where(np.arange(ROWS) >= 250, energy[250], 0.0)
    as_it_was(read(without("voltage", "current", energy_Wh=anew)))
    charge = np.concatenate([[0.0], np.cumsum(0.5 * AMPS[1:] + 0.5 * AMPS[:-1])]) * 0.5 / 3.6
    as_it_was(read(without("current", used_mAh=charge)))
    as_it_was(read(without("voltage", "current", **{"Watt hours used": energy, "Watt hours charged": 0 * energy})))


def test_a_pause_of_the_log_has_no_energy_but_what_a_counter_says():
    t = T + np.where(np.arange(ROWS) > 200, 3600.0, 0.0)
    for columns in (PLAIN, without("voltage", "current", energy_Wh=LEFT)):
        run = read(columns | {"t": t})
        as_it_was(run)
        assert run.notes[-1].startswith("its log has 1 gap, 3,600.5 s in all")


def test_a_state_of_charge_gives_the_energy_of_a_drive_once_the_capacity_is_told():
    soc = 80.0 - np.round(200.0 * np.linspace(0, 0.1, ROWS)) / 2
    columns = without("voltage", "current", battery_percent=soc)
    with pytest.raises(RunsError, match="say what the battery holds with a mapping, such as capacity_wh=500"):
        read(columns)
    run = read(columns, mapping={"capacity_wh": "100"})
    energy, spread = run.energy()
    assert energy == pytest.approx(0.1 * 100 * 3600)
    assert spread == pytest.approx(0.5 * 3600 / np.sqrt(6))  # half a percent of 100 Wh at both ends, evenly distributed
    with pytest.raises(RunsError, match="the energy of the whole drive, and not that of a metre"):
        run.drawn()


@pytest.mark.parametrize("difference", [0.1, 0.001, 0.0])
def test_powers_of_batteries_in_parallel_add(difference):
    two = {"bat1_voltage": VOLTS, "bat1_current": 0.6 * AMPS, "bat2_voltage": VOLTS - difference}
    as_it_was(read(without("voltage", "current", **two, bat2_current=0.4 * AMPS * VOLTS / (VOLTS - difference))))


def test_units_that_no_name_says_are_found_by_agreement():
    speed = np.full(ROWS, 0.9 / 0.5)
    run = read(PLAIN | {"speed": 3.6 * speed, "Power": 1e-3 * VOLTS * AMPS})
    assert run.extras["speed"][5] == pytest.approx(1.8)
    as_it_was(run)
    as_it_was(read(without("t", t=np.round(1000 * T))))  # in ms by the way
    as_it_was(read(without("t", timestamp=45_745.5 + T / 86_400), digits=10))  # of a spreadsheet
    yaw = read(PLAIN | {"yaw": 0.001 * np.sin(T)})  # to the east, anticlockwise from east
    np.testing.assert_allclose(yaw.extras["heading"], 90.0, atol=0.1)


def test_drives_without_positions_have_the_distance_of_their_speed():
    run = read(without("x", "y", **{"Velocity [km/h]": np.full(ROWS, 6.48)}))
    assert not run.placed
    as_it_was(run)
    as_it_was(read(without("x", "y", trip_km=(X - X[0]) / 1000)))
    with pytest.raises(RunsError, match="is Speed in km/h or m/s\\? Say it with a mapping: speed=Speed:km/h"):
        read(without("x", "y", Speed=np.full(ROWS, 6.48)))


def test_two_columns_that_may_be_one_are_asked_for_and_the_product_decides_otherwise():
    both = without("current", pack_current=AMPS, battery_current=2 * AMPS)
    with pytest.raises(
        RunsError, match="which of pack_current, battery_current is its current\\? Say it with a mapping"
    ):
        read(both)
    as_it_was(read(both, mapping={"current": "pack_current"}))
    as_it_was(read(both | {"power": VOLTS * AMPS}))


def test_degrees_and_minutes_are_read_as_text_and_as_numbers():
    lat = 36.1349 + 8.1e-6 * np.arange(ROWS)
    minutes = (lat - 36) * 60
    forms = {
        "text": [f"36 {m:08.5f}" for m in minutes],
        "marks": [f"36°{m:08.5f}'N" for m in minutes],
        "NMEA": 3600 + minutes,
        "e7": np.round(lat * 1e7),
    }
    for form in forms.values():
        run = read(without("x", "y", lat=form, lon=np.full(ROWS, -4.1)), crs="EPSG:32630", digits=7)
        assert np.ptp(run.y) == pytest.approx(ROWS * 8.1e-6 * 110_955, rel=0.01)


@pytest.mark.parametrize("kind", ["lines", "records", "columns", "rows", "split", "streams", "lists", "keys", "line"])
def test_json_of_any_shape(kind):
    records = [
        {"time": t, "pos": {"x": x, "y": 4e6}, "battery": {"voltage": v, "current": i}}
        for t, x, v, i in zip(T.tolist(), X.tolist(), VOLTS.tolist(), AMPS.tolist(), strict=True)
    ]
    plain = {key: values.tolist() for key, values in PLAIN.items()}
    names = [*plain][1:]
    text = {
        "lines": "\n".join(map(json.dumps, records)),
        "records": json.dumps({"about": {"name": "n"}, "data": {"points": records}}, indent=1),
        "columns": json.dumps({"log": plain}),
        "rows": json.dumps([list(plain), *map(list, zip(*plain.values(), strict=True))]),
        "streams": json.dumps([{"type": key, "unit": "", "data": values} for key, values in plain.items()]),
        "line": json.dumps(
            {"a": {key: plain[key] for key in "xy"}, "b": {key: plain[key] for key in plain if key not in "xy"}}
        ),
        "lists": json.dumps(
            {
                key: [{"ts": 1.7e12 + 1e3 * t, "value": f"{v:.6f}"} for t, v in zip(plain["t"], values, strict=True)]
                for key, values in plain.items()
                if key != "t"
            }
        ),
        "keys": json.dumps(
            [
                {
                    "time": t,
                    "data": [{"key": key, "value": {"doubleValue": v}} for key, v in zip(names, row, strict=True)],
                }
                for t, *row in zip(*plain.values(), strict=True)
            ]
        ),
        "split": json.dumps({"columns": list(plain), "data": list(zip(*plain.values(), strict=True))}),
    }[kind]
    as_it_was(parse_run(text, name="r.json"))


SCALED = {"t": ("ms", 1e3), "x": ("cm", 100.0), "y": ("cm", 100.0), "voltage": ("mV", 1e3), "current": ("mA", 1e3)}
SAID = {key: unit for key, (unit, _) in SCALED.items()}
COUNTS = {key: np.round(1e3 * SCALED[key][1] * values) / 1e3 for key, values in PLAIN.items()}
BESIDE = {
    "an object of units": {"about": {"units": SAID}, "data": {key: each.tolist() for key, each in COUNTS.items()}},
    "units of records": {
        "unit": SAID,
        "rows": [
            dict(zip(COUNTS, row, strict=True)) for row in zip(*(v.tolist() for v in COUNTS.values()), strict=True)
        ],
    },
    "a list of units": {
        "columns": [*COUNTS],
        "units": [*SAID.values()],
        "data": [*map(list, zip(*(v.tolist() for v in COUNTS.values()), strict=True))],
    },
    "a unit with each column": {
        "log": {key: {"unit": SAID[key], "values": each.tolist()} for key, each in COUNTS.items()}
    },
    "signals": [{"name": key, "unit": SAID[key], "data": each.tolist()} for key, each in COUNTS.items()],
}


def test_a_json_text_that_breaks_off_says_so():
    rows = [{"t": 0.1 * k, "x": 0.05 * k, "y": 0.0, "power": 20.0} for k in range(50)]
    with pytest.raises(RunsError, match="it breaks off after"):
        parse_run(json.dumps(rows)[:-30], name="r")


@pytest.mark.parametrize("kind", BESIDE)
def test_units_beside_the_data_of_a_json_text_are_used(kind):
    as_it_was(parse_run(json.dumps(BESIDE[kind]), name="r.json"))


@pytest.mark.parametrize("unit", ["ms", "us", "ns", "dates", "rows"])
def test_the_index_of_a_table_of_pandas_is_its_time(unit):
    names = [*PLAIN][1:] if unit != "rows" else [*PLAIN]
    stamps = {"ms": 1e3, "us": 1e6, "ns": 1e9}
    index = [int(stamps.get(unit, 1.0) * (1.7e9 * (unit in stamps) + t)) for t in T.tolist()]
    if unit == "dates":
        index = [f"2025-03-29T14:{t // 60:02.0f}:{t % 60:04.1f}Z" for t in T.tolist()]
    elif unit == "rows":
        index = list(range(T.size))
    data = [*map(list, zip(*(PLAIN[key].tolist() for key in names), strict=True))]
    by_column = {key: dict(zip(map(str, index), PLAIN[key].tolist(), strict=True)) for key in names}
    for document in ({"columns": names, "index": index, "data": data}, by_column):
        run = parse_run(json.dumps(document), name="r.json")
        as_it_was(run)
        assert "index" not in run.extras


def test_objects_in_the_cells_of_a_table_are_columns():
    objects = [
        json.dumps({"level": "INFO", "battery": {"v": v, "a": i}, "pos": {"x": x, "y": 4e6}})
        for x, v, i in zip(X.tolist(), VOLTS.tolist(), AMPS.tolist(), strict=True)
    ]
    objects[7:9] = ["", "{broken"]  # two rows of 400
    quoted = ['"' + text.replace('"', '""') + '"' for text in objects]
    times = [f"2025-03-29 14:{t // 60:02.0f}:{t % 60:04.1f}" for t in T]
    rows = [f"{t},{text},rover/main" for t, text in zip(times, quoted, strict=True)][::-1]
    run = parse_run("\n".join(["@timestamp,@message,@logStream", *rows]) + "\n", name="r")
    as_it_was(run)
    assert run.reading["voltage"] == "@message.battery.v [V]"


LONG = [(t, key, v) for t, *row in zip(*PLAIN.values(), strict=True) for key, v in zip([*PLAIN][1:], row, strict=True)]
WORDS = {"t": "日時", "lat": "緯度", "lon": "経度", "voltage": "電圧(V)", "current": "電流(A)"}
SHAPES = {
    "rows of a quantity": ["Series;Time;Reading", *(f"{key};{t};{v:.6f}" for t, key, v in LONG)],
    "no header": [f"2025-03-29T14:{t // 60:02.0f}:{t % 60:04.1f}Z robot/{key} {v:.6f}" for t, key, v in LONG],
    "fields and values": [
        "Type,Field 1,Value 1,Units 1,Field 2,Value 2,Units 2,Field 3,Value 3,Units 3,Field 4,Value 4,Units 4",
        *(
            f'Data,timestamp,"{t}",s,x,"{x:.6f}",m,y,"4000000",m,power,"{v * i:.6f}",W,'
            for t, x, v, i in zip(T, X, VOLTS, AMPS, strict=True)
        ),
    ],
}


@pytest.mark.parametrize("shape", SHAPES)
def test_rows_that_name_their_quantities(shape):
    as_it_was(parse_run("\n".join(SHAPES[shape]) + "\n", name="r"))


@pytest.mark.parametrize("form", ["{:,.0f}", "{:,.3f}", "german"])
def test_marks_between_thousands_are_no_decimal_marks(form):
    def _cell(value):
        return f"{value:,.3f}".translate(str.maketrans(",.", ".,")) if form == "german" else form.format(value)

    driven = 1e3 * (X - X[0])
    rows = [f"{t};{_cell(x)};{_cell(v * i * 1e3)}" for t, x, v, i in zip(T, driven, VOLTS, AMPS, strict=True)]
    as_it_was(parse_run("\n".join(["t;distance (mm);power (mW)", *rows]) + "\n", name="r"))


def test_cells_in_quotes_with_commas_and_dates_in_them():
    rows = [
        f'"Nov 14, 2026 @ 10:{t // 60:02.0f}:{t % 60:06.3f}","rover 7","{i:.4f}","{v:.4f}","{x:,.2f}","-"'
        for t, x, v, i in zip(T, X - X[0] + 900.0, VOLTS, AMPS, strict=True)
    ]
    head = '"@timestamp","agent.name","battery.current","battery.voltage","odometer.meters","message"'
    run = parse_run("\n".join([head, *rows[::-1]]) + "\n", name="r")
    as_it_was(run)
    assert len(run.t) == ROWS


COMMENTS = {
    "unit and name": "# Logger 1.4\n# date: 2026-11-14\n# columns:\n#   1 ms uptime\n#   2 mV battery voltage\n"
    "#   3 mA battery current (positive = discharge)\n#   4 mm odometer\n",
    "name and unit": "# Column 1: Time [ms]\n# Column 2: Battery voltage [mV]\n# Column 3: Battery current [mA]\n"
    "# Column 4: Distance [mm]\n",
    "nothing": "",
    "remarks": "# Logger 1.4\n# 2026-11-14\n",
}


@pytest.mark.parametrize("comments", COMMENTS)
def test_a_table_without_a_header_is_read_by_its_comments_or_by_numbers(comments):
    rows = [
        f"{1e3 * t:.0f}\t{1e3 * v:.1f}\t{1e3 * i:.1f}\t{1e3 * x:.0f}"
        for t, x, v, i in zip(T, X - X[0], VOLTS, AMPS, strict=True)
    ]
    text = COMMENTS[comments] + "\n".join(rows) + "\n"
    said = {"t": "column 1:ms", "voltage": "column 2:mV", "current": "column 3:mA", "distance": "column 4:mm"}
    as_it_was(parse_run(text, name="r", mapping=said))
    if comments in ("nothing", "remarks"):
        with pytest.raises(RunsError, match=r"a line with the names of the columns above it, or .* t=column 1:ms"):
            parse_run(text, name="r")
    else:
        as_it_was(parse_run(text, name="r"))


def test_times_of_laps_what_is_left_and_spaces_before_quotes():
    rows = zip(T, X - X[0], 50 - LEFT, strict=True)
    left = [f'"{t // 60:02.0f}:{t % 60:04.1f}"; "{x:.3f}"; "{e:.6f}"' for t, x, e in rows]
    as_it_was(parse_run("\n".join(['"Lap time"; "Distance [m]"; "Remaining energy [Wh]"', *left]) + "\n", name="r"))
    with pytest.raises(RunsError, match="neither a column 'current'"):
        read({"t": T, "speed": np.full(ROWS, 1.8), "Consumption (kWh/100km)": VOLTS + AMPS})


@pytest.mark.parametrize("unit", [1.0, 3.6])
def test_radians_are_told_by_the_speed(unit):
    lat = np.radians(36.1 + 8.1e-6 * np.arange(ROWS))
    speed = np.full(ROWS, unit * 8.1e-6 * 110_955 / 0.5)
    columns = without("x", "y", Latitude=lat, Longitude=np.full(ROWS, np.radians(-4.1)), Speed=speed)
    run = read(columns, crs="EPSG:32630", digits=10)
    assert np.ptp(run.y) == pytest.approx(ROWS * 8.1e-6 * 110_955, rel=0.01)
    assert any("taken for radians" in note for note in run.notes)


@pytest.mark.parametrize("encoding", ["cp932", "gb18030", "utf-8"])
def test_names_of_east_asia_are_read_in_their_encodings(encoding):
    columns = without("x", "y", lat=36.1 + 8.1e-6 * np.arange(ROWS), lon=np.full(ROWS, -4.1))
    chinese = {"t": "数据时间", "lat": "纬度", "lon": "经度", "voltage": "总电压", "current": "总电流"}
    words = chinese if encoding == "gb18030" else WORDS
    text = "\n".join(lines({words[key]: values for key, values in columns.items()}, digits=7)) + "\n"
    run = parse_run(text.encode(encoding), name="r", crs="EPSG:32630")
    assert np.ptp(run.y) == pytest.approx(ROWS * 8.1e-6 * 110_955, rel=0.01)
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.01)


@pytest.mark.parametrize("irregular", [False, True])
def test_no_even_drive_has_gaps_at_rows_of_seconds(irregular):
    t = np.cumsum(np.tile([1.0, 2.0, 5.0, 9.0], 100)) if irregular else np.arange(400.0)
    run = read(without("x", "t", t=t, x=500_000 + 15.0 * t, power=np.full(400, 4000.0)))
    segments = cut_segments(run)
    assert segments.left_out == {}
    assert segments.driven_m.sum() == pytest.approx(15.0 * np.ptp(t))
    assert segments.length_m == (135.0 if irregular else 15.0)  # what nine of ten fixes are from the next
    assert cut_segments(read(PLAIN)).length_m == 1.0


def test_a_drive_without_positions_is_compared_on_a_strip_with_its_heights():
    heights = 100.0 + 5.0 * np.sin((X - X[0]) / 60.0)
    drive = {key: PLAIN[key] for key in ("t", "voltage", "current")} | {"distance_m": X - X[0], "altitude": heights}
    run = read(drive)
    ground = ground_of_profile(run)
    np.testing.assert_allclose(ground.sample(np.zeros(50), run.y[100:150]), heights[100:150], atol=0.05)
    found = jm.evaluate(runs=drive, model="physics", robot={"mass_kg": 60, "speed_mps": 2.0}).document
    assert found["segments"] == pytest.approx(METRES, abs=2)
    assert found["left_out"] == {}
    with pytest.raises(InputError, match="has positions: give the heightmap"):
        jm.evaluate(runs=PLAIN, model="physics")


def test_tables_of_one_recording_are_one_log(tmp_path):
    """As tools write bags: a file for each topic, of its own rate, with the same stamps and other columns."""
    slow = np.arange(ROWS) % 4 == 0
    odom = {"timestamp": 1e6 * T, "seq": np.arange(ROWS), "x": X, "y": PLAIN["y"]}
    odom["heading"] = np.full(ROWS, 90.0)
    battery = {
        key: values[slow] for key, values in {"timestamp": 1e6 * T, "seq": T, "Volt": VOLTS, "Curr": AMPS}.items()
    }
    battery["U"] = np.ones(slow.sum())
    texts = {"odom.csv": lines(odom, digits=3), "battery.csv": lines(battery)}

    def _zip(files):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            for name, rows in files.items():
                archive.writestr(f"drive/{name}", "\n".join(rows) + "\n")
        return out.getvalue()

    (tmp_path / "r.zip").write_bytes(_zip(texts))
    assert CliRunner().invoke(app, ["import", str(tmp_path / "r.zip"), "--out", str(tmp_path / "out")]).exit_code == 0
    as_it_was(read_run(tmp_path / "out" / "r.csv"))
    (tmp_path / "drive").mkdir()
    for name, rows in texts.items():
        (tmp_path / "drive" / name).write_text("\n".join(rows) + "\n")
    as_it_was(read_run(tmp_path / "drive"))
    with pytest.raises(RunsError, match="holds several logs: a and b have the same columns"):
        parse_run(_zip({"a.csv": lines(PLAIN), "b.csv": lines(PLAIN)}), name="r.zip")
    with pytest.raises(RunsError, match="several files of the same name"):
        parse_run(_zip({"a/log.csv": lines(PLAIN), "b/log.csv": lines(PLAIN)}), name="r.zip")
    other = lines({"when": T, "voltage": VOLTS, "current": AMPS})
    for wrong in (1e3 * T, 1e6 * T + 1e12):  # ms beside us, and another day
        late = lines({**battery, "timestamp": wrong[slow]})
        with pytest.raises(RunsError, match=r"`timestamp` is not one clock: .* in battery"):
            parse_run(_zip({"odom.csv": texts["odom.csv"], "battery.csv": late}), name="r.zip")
    with pytest.raises(RunsError, match="no column of time in common"):
        parse_run(_zip({"odom.csv": texts["odom.csv"], "battery.csv": other}), name="r.zip")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_a_way_down_the_voltage_tells_which_sign_discharges(sign):
    """In most rows the battery is charged, though more is drawn in sum: it falls under load, whatever the sign."""
    amps = np.where(np.sin(T / 9.0) > 0.3, 9.0, -4.0) + np.sin(3.0 * T)
    assert np.median(amps) < 0 < np.trapezoid(amps, T)
    run = read(without(voltage=48.0 - 0.05 * amps, current=sign * amps))
    assert np.trapezoid(run.current_a, run.t) == pytest.approx(np.trapezoid(amps, T), rel=0.05)


@pytest.mark.parametrize("position", [{"x": np.full(ROWS, 5e5), "y": np.full(ROWS, 4e6)}, {"lat": 0 * T, "lon": 0 * T}])
def test_positions_without_a_fix_do_not_replace_the_wheels(position):
    """The speed is in km/h, which the distance tells."""
    run = read(without("x", "y", speed=np.full(ROWS, 3.6 * 1.8), distance=np.floor(X - X[0]), **position))
    as_it_was_driven(run)
    assert any("positions are the same in every row" in note for note in run.notes)


@pytest.mark.parametrize("standing", [{"lat": 45.0 + 0 * T, "lon": 8.0 + 0 * T}, {"x": 0 * T, "y": 0 * T}])
def test_positions_without_a_fix_do_not_replace_others(standing):
    east = np.degrees((X - X[0]) / (6.378e6 * np.cos(np.radians(45.0))))
    moving = {"x": X, "y": PLAIN["y"]} if "lat" in standing else {"latitude": 45.0 + 0 * T, "longitude": 8.0 + east}
    run = read(without("x", "y", **standing, **moving), crs="EPSG:32632", digits=8)
    as_it_was(run)
    assert any("positions are the same in every row" in note for note in run.notes)


def test_an_odometer_in_another_unit_does_not_replace_the_speed():
    as_it_was_driven(read(without("x", "y", **{"speed [m/s]": np.full(ROWS, 1.8), "odometer": (X - X[0]) / 1609.0})))


def test_a_date_in_whole_minutes_gives_way_to_a_finer_time():
    minutes = [f"30/01/2020 {8 + int(t) // 3600:02d}:{int(t) // 60 % 60:02d}" for t in T]
    as_it_was(read({"Date/Time": minutes, **without("t"), "epoch time": 1_580_371_200 + T}))


def as_it_was_driven(run):
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.01)
    assert np.ptp(run.y) == pytest.approx(METRES, rel=0.01)


def test_a_packed_log_is_unpacked_within_bounds():
    text = "\n".join(lines(PLAIN)).encode()

    def _zip(**files):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                archive.writestr(name, content)
        return out.getvalue()

    as_it_was(parse_run(gzip.compress(text), name="r.csv.gz"))
    as_it_was(parse_run(_zip(log=text), name="r.zip"))
    with pytest.raises(RunsError, match="holds several logs: a and b have the same columns"):
        parse_run(_zip(a=text, b=text), name="r.zip")
    with pytest.raises(RunsError, match="is a spreadsheet: save the sheet as CSV"):
        parse_run(_zip(**{"[Content_Types].xml": "x", "sheet": "y"}), name="r.xlsx")
    with pytest.raises(TooLargeError, match="unpacks to more than"):
        parse_run(gzip.compress(bytes(100_000_000)), name="r.csv.gz")
    with pytest.raises(RunsError, match="not a readable archive"):
        parse_run(_zip(log=text)[:-30], name="r.zip")


@pytest.mark.parametrize(
    ("target", "column", "sureness"),
    [
        ("voltage", "Battery Voltage [V]", LIKELY),
        ("voltage", "battvolt", LIKELY),
        ("voltage", "Heater Voltage [V]", None),
        ("current", "amps_in", LIKELY),
        ("current", "current_motor", None),
        ("current", "current_speed", None),
        ("speed", "current_speed", 1),
        ("speed", "wind_speed", None),
        ("x", "/odom/pose/pose/position/x", LIKELY),
        ("x", "accel_x", None),
        ("x", "gps_utmE", LIKELY),
        ("y", "utm_n", LIKELY),
        ("y", "N", None),
        ("y", "utm_nord", LIKELY),
        ("t", "timestamp_ms", NAMED),
        ("t", "Time to full", None),
        ("soc", "battery_level", LIKELY),
        ("energy", "energy_Wh", NAMED),
        ("z", "Temperature [m]", None),
    ],
)
def test_what_a_name_says(target, column, sureness):
    found = candidate(target, column)
    assert (found.sureness if found is not None else None) == sureness


# ---------------------------------------------------------------- the files beside the checkout


@pytest.fixture(scope="module")
def wild():
    named = os.environ.get("JOULEMAP_WILD_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2].parent / "shared" / "wild"
    if not folder.is_dir():
        pytest.skip(f"no wild files at {folder}: set JOULEMAP_WILD_DATA to their folder to run this test")
    return folder, json.loads((folder / "answers.json").read_text())


def imported(files, tmp_path, *options):
    out = tmp_path / "answer.json"
    found = CliRunner().invoke(app, ["import", *map(str, files), *options, "--json", str(out)])
    return found, json.loads(out.read_text())["runs"] if found.exit_code == 0 else []


def test_every_wild_log_gives_its_answer(wild, tmp_path):
    folder, answers = wild
    groups = {}
    for file, answer in answers.items():
        if file.startswith("logs/") and "refused" not in answer:
            options = ("--map", answer["mapping"]) if "mapping" in answer else ()
            if file == "logs/charge_only.csv":
                options = ("--map", "capacity_wh=20")  # its note says so
            groups.setdefault(options, []).append(file)
    copies = {"same_b.csv", "same_c.csv"}  # of same_a.csv: one run
    seen = set()
    for options, files in groups.items():
        found, runs = imported([folder / file for file in files], tmp_path, *options)
        assert found.exit_code == 0, found.output
        for run in runs:
            answer = answers[f"logs/{run['name']}"]
            share = answer.get("tolerance", 0.01)
            assert run["metres"] == pytest.approx(answer["metres"], rel=share), run["name"]
            assert run["energy_j"] == pytest.approx(answer["energy_j"], rel=share), run["name"]
            assert run["unknown_seconds"] == pytest.approx(answer.get("unknown_seconds", run["unknown_seconds"]), abs=1)
            seen.add(run["name"])
    expected = {
        Path(file).name for file, answer in answers.items() if file.startswith("logs/") and "refused" not in answer
    }
    assert seen == expected - copies


def test_every_wild_log_without_a_reading_is_refused_with_its_reason(wild, tmp_path):
    folder, answers = wild
    for file, answer in answers.items():
        if file.startswith("logs/") and "refused" in answer:
            found, _ = imported([folder / file], tmp_path)
            assert found.exit_code == 3
            assert answer["refused"] in " ".join(found.output.split())
