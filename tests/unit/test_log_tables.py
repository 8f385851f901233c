"""Tables of other loggers: separators, decimal commas, times as text, other names and units, and mappings."""

import numpy as np
import pytest

from joulemap.model.errors import RunsError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.instants import across_midnight, seconds_of
from joulemap.model.runs.mapping import read_mapping, source_of
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.plausible import implausible
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.model.runs.units import conversion, unit_in_name

ROWS = 80
T = np.round(0.1 * np.arange(ROWS), 3)
X = np.round(500_000 + 0.05 * np.arange(ROWS), 3)
CURRENT = np.round(2.0 + np.sin(T), 3)


def table(columns, separator=",", decimal="."):
    lines = [separator.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(separator.join(str(cell).replace(".", decimal) for cell in row))
    return "\n".join(lines) + "\n"


PLAIN = {"t": T, "x": X, "y": np.full(ROWS, 4_000_000.0), "voltage": np.full(ROWS, 24.5), "current": CURRENT}


@pytest.mark.parametrize(
    "content",
    [
        table(PLAIN, ";"),
        table(PLAIN, "\t"),
        table(PLAIN, ";", ","),
        "# logged by a logger\n% and commented\n\n" + table(PLAIN),
        table(PLAIN).encode("utf-16"),
        table(PLAIN | {"luftfeuchte °": np.ones(ROWS)}).encode("cp1252"),
        "".join(f"{line};\n" for line in table(PLAIN, ";").splitlines()),
    ],
    ids=["semicolons", "tabs", "decimal commas", "comments", "UTF-16", "cp1252", "separator at the end"],
)
def test_texts_of_other_programs_are_the_same_run(content):
    run = parse_run(content, name="r")
    np.testing.assert_array_equal(run.t, T)
    np.testing.assert_array_equal(run.x, X)
    np.testing.assert_allclose(run.drawn(), 24.5 * CURRENT)


def test_names_and_units_are_recognised_and_reported():
    columns = {
        "timestamp_ms": (1_700_000_000_000 + 100 * np.arange(ROWS)),
        "latitude": 36.7 + 4e-7 * np.arange(ROWS),
        "longitude": np.full(ROWS, -4.49),
        "Battery Voltage (mV)": np.full(ROWS, 24_500),
        "batt_current_mA": 1000 * CURRENT,
        "motor": ["a b"] * ROWS,
    }
    run = parse_run(table(columns), name="r", crs="EPSG:32630")
    np.testing.assert_allclose(np.diff(run.t), 0.1, atol=1e-6)
    np.testing.assert_allclose(run.current_a, CURRENT)
    np.testing.assert_allclose(run.voltage_v, 24.5)
    assert run.reading == {
        "t": "timestamp_ms [ms]",
        "lat": "latitude [deg]",
        "lon": "longitude [deg]",
        "voltage": "Battery Voltage (mV) [mV]",
        "current": "batt_current_mA [mA]",
    }
    assert run.texts["motor"][0] == "a b"


def test_a_mapping_sums_with_signs_and_takes_factors():
    columns = {
        "when": T,
        "e": X,
        "n": np.zeros(ROWS),
        "i-left": CURRENT,
        "i-right": -CURRENT,
        "volts": np.full(ROWS, 12),
    }
    mapping = read_mapping(["t=when,x=e,y=n:0.5", "current=i-left - i-right:mA", "voltage=volts"])
    run = parse_run(table(columns), name="r", mapping=mapping)
    np.testing.assert_allclose(run.current_a, 2e-3 * CURRENT)
    assert run.reading["current"] == "i-left-i-right [mA]"


def test_a_pack_current_that_is_negative_when_discharging_is_turned_round_although_the_robot_mostly_rests():
    current = np.where(np.arange(ROWS) < 50, 0.0, -CURRENT)
    run = parse_run(table(PLAIN | {"current": current}), name="r")
    assert run.current_a[60] == CURRENT[60]
    assert run.repairs["current_sign_flipped"] == 1
    said = parse_run(table(PLAIN), name="r", mapping={"power": "-current:W"})
    np.testing.assert_allclose(said.drawn(), -CURRENT)  # a sign that is said is kept


@pytest.mark.parametrize(
    ("texts", "steps"),
    [
        (["2024-05-01T23:59:59.5Z", "2024-05-02T00:00:00.25Z"], 0.75),
        (["2024-05-01 12:00:00", "2024-05-01 12:00:01.123456789"], 1.123456789),
        (["01.05.2024 12:00:00,5", "01.05.2024 12:00:01,0"], 0.5),
        (["2024/5/1 1:00", "2024/5/1 2:00"], 3600.0),
        (["03/29/2025 23:59:59", "03/30/2025 00:00:01"], 2.0),
        (["29/03/2025 23:59:59", "30/03/2025 00:00:01"], 2.0),
        (["29-Mar-2025 23:59:59.250", "30-Mar-2025 00:00:01.500"], 2.25),
        (["11:59:59 AM", "12:00:01 PM"], 2.0),
        (["noon", "midnight"], None),
        (["23:59:59.5", "00:00:00.5"], 1.0),
    ],
)
def test_times_as_text(texts, steps):
    if steps is None:
        with pytest.raises(ValueError, match="0"):
            seconds_of(texts)
        return
    np.testing.assert_allclose(np.diff(across_midnight(seconds_of(texts)[0])), steps, atol=1e-6)


def test_iso_times_in_a_column_t_and_a_cell_that_is_none():
    times = [f"2024-05-01T12:00:{k / 10:06.3f}+02:00" for k in range(ROWS)]
    np.testing.assert_allclose(np.diff(parse_run(table(PLAIN | {"t": times}), name="r").t), 0.1, atol=1e-6)
    times[7] = "noon"
    run = parse_run(table(PLAIN | {"t": times}), name="r")
    assert run.repairs == {"rows_without_time": 1, "unreadable_t": 1}


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        (
            {"current": "curent"},
            "`current` is to be taken from 'curent', which is no column of it; near it are current",
        ),
        ({"current": "current:mAh"}, "`current` cannot be in 'mAh': its units are A, mA, cA, dA, or a factor"),
        (["current"], None),
        ({"a b": "current"}, "no name of a column"),
        ("nothing.toml", "nothing.toml: No such file"),
        (["t=t", "t=x"], "gives the column `t` twice"),
    ],
)
def test_mappings_that_cannot_be_are_refused_in_words(mapping, message):
    with pytest.raises(RunsError, match=message or "no entry of a mapping"):
        parse_run(table(PLAIN), name="r", mapping=read_mapping(mapping))


def test_a_cell_of_a_nul_character_is_blank():
    columns = {"time": T, "x": X, "y": np.full(ROWS, 4_000_000.0), "volts": np.full(ROWS, 24.5)}
    mapping = read_mapping(["t=time:s,voltage=volts:V,current=amps:A"])
    runs = []
    for cell in ("", "\0"):
        amps = [str(value) for value in CURRENT]
        amps[7] = cell
        runs.append(parse_run(table(columns | {"amps": amps}), name="r", mapping=mapping))
    np.testing.assert_array_equal(runs[1].current_a, runs[0].current_a)


def test_a_mapping_in_toml(tmp_path):
    (tmp_path / "map.toml").write_text('t = "t"\ncurrent = "current:mA"\n')
    assert read_mapping(tmp_path / "map.toml") == {"t": "t", "current": "current:mA"}
    (tmp_path / "map.toml").write_text("t = 5\n")
    with pytest.raises(RunsError, match="write the name of a column"):
        read_mapping(str(tmp_path / "map.toml"))
    (tmp_path / "map.toml").write_text("t = ")
    with pytest.raises(RunsError, match="no TOML file"):
        read_mapping(tmp_path / "map.toml")


def test_units_by_hand():
    assert unit_in_name("speed", "gps speed [km/h]") == ("gps speed", "km/h")
    assert unit_in_name("speed", "speed_m_s") == ("speed", "m/s")
    assert unit_in_name("x", "x") == ("x", None)
    factor, offset = conversion("temperature", "degF")
    assert factor * 212 + offset == pytest.approx(100.0)
    assert conversion("lat", "semicircles")[0] * 2**31 == pytest.approx(180.0)
    assert source_of("t", "a:b", ["a:b"], "r").columns == ["a:b"]  # a name with a colon


def test_logs_of_known_programs_need_no_mapping(tmp_path):
    clock = [f"12:00:{k / 10:06.3f}" for k in range(ROWS)]
    wheellog = {
        "date": ["2024-05-01"] * ROWS,
        "time": clock,
        "latitude": 36.7 + 4.5e-6 * np.arange(ROWS),
        "longitude": np.full(ROWS, -4.49),
        "speed": np.full(ROWS, 18.0),
        "voltage": np.full(ROWS, 60.0),
        "current": CURRENT,
        "totaldistance": np.arange(ROWS),
    }
    run = parse_run(table(wheellog), name="r", crs="EPSG:32630")
    assert run.reading["t"] == "date+time [date and time]"
    assert run.extras["speed"][0] == 5.0
    np.testing.assert_allclose(np.diff(run.t), 0.1, atol=1e-6)
    vesc = {
        "ms_today": (86_396_000 + 100 * np.arange(ROWS)) % 86_400_000,  # over midnight
        "input_voltage": np.full(ROWS, 40.0),
        "current_in": CURRENT,
        "gnss_lat": 36.7 + 4e-7 * np.arange(ROWS),
        "gnss_lon": np.where(np.arange(ROWS) == 0, 0.0, -4.49),
    }
    vesc["gnss_lat"][0] = 0.0  # no fix yet
    run = parse_run("".join(f"{line};\n" for line in table(vesc, ";").splitlines()), name="r", crs="EPSG:32630")
    assert run.t[-1] - run.t[0] == pytest.approx(7.9)
    assert np.isnan(run.x[0])
    husky = {"time": T, "curL": CURRENT, "curR": CURRENT, "velL": np.full(ROWS, 0.5), "velR": np.full(ROWS, 0.5)}
    (tmp_path / "a.csv").write_text(table(husky))
    run = read_run(tmp_path / "a.csv", odometry=Odometry(1.0))
    np.testing.assert_allclose(run.current_a, 2 * CURRENT)
    assert run.reading["current_left"] == "curL [A]"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"current": 1000 * CURRENT}, "current is 2,... A at 24.5 V: is `current` in mA"),
        ({"voltage": np.full(ROWS, 24_500.0)}, "voltage is 24,500 V: is `voltage` in mV"),
        ({"t": 100_000 * T}, "to the next it is 10,000 s: is `t` in ms"),
        (
            {"x": -4.49 + 4e-7 * np.arange(ROWS), "y": np.full(ROWS, 36.7)},
            "are `x` and `y` a longitude and a latitude",
        ),
    ],
)
def test_units_that_cannot_be_are_said(columns, message):
    run = parse_run(table(PLAIN | columns), name="r")
    found = " ".join(implausible(run, cut_segments(run)))
    assert __import__("re").search(message, found), found
    good = parse_run(table(PLAIN), name="r")
    assert implausible(good, cut_segments(good)) == []


def test_a_quote_that_is_never_closed_loses_no_rows_in_silence():
    lines = table(PLAIN | {"terrain": ["grass"] * ROWS}).splitlines()
    for row in (f'"{lines[20]}', lines[20].replace("grass", '"grass')):
        with pytest.raises(RunsError, match=r"row 21: a quote is opened there and never closed: the 60 lines"):
            parse_run("\n".join([*lines[:20], row, *lines[21:]]) + "\n", name="r")
    long = "\n".join([*lines[:20], f'"{lines[20]}', *([lines[21]] * 5000)])
    with pytest.raises(RunsError, match=r"row 21: a quote is opened there and never closed"):
        parse_run(long, name="r")
    cut = parse_run("\n".join([*lines[:-1], lines[-1].replace("grass", '"gra')]), name="r")
    assert (len(cut), cut.repairs) == (ROWS - 1, {"truncated_rows": 1})
    closed = parse_run("\n".join([*lines[:-1], lines[-1].replace("grass", '"wet\ngrass"')]), name="r")
    assert (len(closed), closed.texts["terrain"][-1], closed.repairs) == (ROWS, "wet\ngrass", {})


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-32"])
def test_a_text_of_another_encoding_is_named_as_such(encoding):
    with pytest.raises(RunsError, match="NUL characters, so it is no text in UTF-8"):
        parse_run(table(PLAIN).encode(encoding), name="r")


def test_millions_of_comments_before_the_header_are_passed_over():
    assert len(parse_run(b"#\n" * 1_000_000 + table(PLAIN).encode(), name="r")) == ROWS
    with pytest.raises(RunsError, match="the file is empty"):
        parse_run("# nothing but a comment\n", name="r")
    with pytest.raises(RunsError, match="0 rows are too few"):
        parse_run("# a comment that breaks off", name="r")


@pytest.mark.parametrize(
    ("columns", "amps"),
    [
        ({"current_mA": 1000 * CURRENT}, CURRENT),
        ({"current [mA]": 1000 * CURRENT}, CURRENT),
        ({"current_A": CURRENT, "voltage": PLAIN["voltage"]}, CURRENT),
        ({"current_left_mA": 600 * CURRENT, "current_right_mA": 400 * CURRENT}, CURRENT),
        ({"current_mA": 1000 * CURRENT, "current_motor": 0.5 * CURRENT}, CURRENT),
        ({"current_a": CURRENT, "current_b": 2 * CURRENT}, 3 * CURRENT),
    ],
    ids=["mA", "mA in brackets", "A", "two motors in mA", "pack and motor", "motors a and b"],
)
def test_a_current_whose_name_ends_with_its_unit_is_in_that_unit(columns, amps):
    log = {key: values for key, values in PLAIN.items() if key != "current"} | columns
    np.testing.assert_allclose(parse_run(table(log), name="r").current_a, amps, rtol=1e-9)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"current": np.zeros(ROWS)}, "its current is 0 A in all rows: was it recorded?"),
        ({"power": np.zeros(ROWS)}, "its power is 0 W in all rows: was it recorded?"),
        ({"power": np.full(ROWS, 0.04)}, "a metre took 0.08 J: is `power` in kW?"),
    ],
)
def test_a_drive_that_took_nothing_is_implausible(columns, words):
    run = parse_run(table({key: PLAIN[key] for key in "txy"} | columns), name="r")
    assert words in implausible(run, cut_segments(run, charge=not run.has_energy))
