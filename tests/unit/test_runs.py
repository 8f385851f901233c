"""Reading runs: every stated rule on a log made by hand, and what cannot be read is refused with its place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.errors import InputError, RunsError
from joulemap.model.runs.reader import _longest_increasing, parse_run, read_run


def log(n=60, **columns):
    """A clean log of a robot that drives north at 0.5 m/s, 10 Hz, with columns replaced or added; as rows of texts."""
    base = {
        "t": [f"{0.1 * k:.2f}" for k in range(n)],
        "x": ["10.000"] * n,
        "y": [f"{0.05 * k:.3f}" for k in range(n)],
        "voltage": ["28.0"] * n,
        "current": ["2.0"] * n,
    }
    base.update(columns)
    return {key: list(values) for key, values in base.items() if values is not None}


def text(columns):
    return "\n".join([",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))])


def parse(columns, **options):
    return parse_run(text(columns), name="run.csv", **options)


def test_a_clean_run_needs_no_repair(tmp_path):
    columns = log(terrain=["grass"] * 60, wind_speed=[""] * 60, lidar=["7"] * 60)
    (tmp_path / "run.csv").write_text("\ufeff" + text(columns) + "\n")  # a byte order mark, as spreadsheets write
    run = read_run(tmp_path / "run.csv")
    assert run.repairs == {}
    assert len(run) == 60
    np.testing.assert_allclose(run.y, 0.05 * np.arange(60))
    assert run.extras["lidar"][3] == 7.0
    assert np.isnan(run.extras["wind_speed"]).all()
    assert run.texts["terrain"][0] == "grass"


def test_repeated_and_backward_stamps_are_dropped():
    columns = log()
    for values in columns.values():
        values.insert(10, values[9])  # a row written twice
        values.insert(31, values[20])  # a row that comes late
    columns["t"][31] = "1.95"
    run = parse(columns)
    assert run.repairs == {"duplicate_stamps": 1, "backward_stamps": 1}
    assert (np.diff(run.t) > 0).all()
    assert len(run) == 60


def test_one_stamp_far_ahead_does_not_cost_the_rest_of_the_run():
    columns = log()
    columns["t"][20] = "99.0"
    run = parse(columns)
    assert run.repairs == {"backward_stamps": 1}
    assert len(run) == 59


def test_a_clock_set_back_is_refused_with_its_row():
    columns = log()
    columns["t"][30:] = [f"{0.1 * k:.2f}" for k in range(30)]
    columns["t"][30:] = [str(float(v) + 0.05) for v in columns["t"][30:]]
    with pytest.raises(RunsError, match="row 32: the clock was set back"):
        parse(columns)


def test_rows_without_time_and_a_line_that_breaks_off():
    columns = log()
    columns["t"][5] = ""
    run = parse_run(text(columns) + "\n6.0,10.0", name="r")
    assert run.repairs == {"truncated_rows": 1, "rows_without_time": 1}


def test_float_fixes_are_not_used_and_zero_means_not_reported():
    error = ["0.012"] * 60
    error[20:24] = ["0.40"] * 4
    error[40] = "0"
    run = parse(log(gps_error=error))
    assert run.repairs == {"bad_fixes": 4}
    assert np.isnan(run.x[20:24]).all()
    assert np.isfinite(run.x).sum() == 56


def test_a_receiver_of_metres_is_not_refused_altogether():
    run = parse(log(gps_error=["1.8"] * 60))
    assert run.repairs == {}


def test_a_jump_and_back_is_masked_and_a_jump_for_good_breaks_the_track():
    columns = log(n=200)
    columns["x"][50:53] = ["18.0"] * 3
    assert parse(columns).repairs == {"position_jumps": 3}
    for k in range(100, 200):
        columns["x"][k] = "25.0"
    run = parse(columns)
    assert run.repairs == {"position_jumps": 3, "position_breaks": 1}
    assert np.flatnonzero(run.breaks).tolist() == [100]
    assert np.isfinite(run.x).sum() == 197


def test_a_slow_receiver_writes_its_fix_again():
    columns = log(n=100)
    columns["y"] = [f"{0.5 * (k // 10):.3f}" for k in range(100)]  # 1 Hz fixes in a 10 Hz log
    run = parse(columns)
    assert run.repairs == {"held_fixes": 90}
    np.testing.assert_allclose(run.y[np.isfinite(run.y)], 0.5 * np.arange(10))


def test_spikes_and_blanks_are_bridged():
    columns = log()
    columns["voltage"][10] = "280.0"
    columns["voltage"][20] = ""
    columns["current"][30] = "20.0"
    columns["current"][40] = "nan"
    run = parse(columns)
    assert run.repairs == {"voltage_spikes": 1, "blank_voltage": 1, "current_spikes": 1, "blank_current": 1}
    np.testing.assert_allclose(run.voltage_v, 28.0)
    np.testing.assert_allclose(run.current_a, 2.0)


def test_a_slow_meter_writes_its_reading_again():
    amps = [2.0, 3.0, 9.0, 4.0, 2.0, 5.0, 3.0, 4.0, 2.0, 3.0, 4.0, 6.0]
    run = parse(log(n=120, current=[f"{a:.1f}" for a in np.repeat(amps, 10)]))  # 1 Hz readings in a 10 Hz log
    assert run.repairs == {"held_current": 108}
    np.testing.assert_allclose(run.current_a[:111], np.interp(np.arange(111) / 10.0, np.arange(12), amps))
    sides = {"current_left": log(n=120)["current"], "current_right": [f"{a:.1f}" for a in np.repeat(amps, 10)]}
    both = parse(log(n=120, current=None, **sides))
    assert both.repairs == {"held_current_right": 108}
    np.testing.assert_allclose(both.current_a[:111], 2.0 + run.current_a[:111])


def test_a_climb_is_no_spike():
    amps = 2.0 + 6.0 * np.exp(-0.5 * ((np.arange(60) - 30) / 4.0) ** 2)
    run = parse(log(current=[f"{a:.3f}" for a in amps]))
    np.testing.assert_allclose(run.current_a, amps, atol=1e-3)
    assert run.repairs == {}


def motors(left, right, **more):
    """A log of two motors' currents."""
    sides = {"current_left": [str(v) for v in left], "current_right": [str(v) for v in right]}
    return log(len(left), current=None, **sides, **more)


def test_a_motor_that_feeds_back_is_not_counted_as_consumption():
    left, right = np.full(60, 9.0), np.where(np.arange(60) < 30, 4.0, -3.0)  # the inner side of a long turn
    run = parse(motors(left, right))
    assert run.repairs == {}
    assert run.of_motors
    assert not parse(log(60)).of_motors
    np.testing.assert_allclose(run.current_a, left + right)
    assert parse(motors(left, right), currents="magnitude").repairs == {"currents_as_magnitudes": 1}
    np.testing.assert_allclose(parse(motors(left, right), currents="magnitude").current_a, left + np.abs(right))
    other = {"left_current": left, "right_current": right}
    named = parse(log(60, current=None, **{key: [str(v) for v in values] for key, values in other.items()}))
    np.testing.assert_allclose(named.current_a, left + right)
    assert named.extras.keys() == {}.keys()


def test_motors_mounted_as_mirror_images_are_summed_by_magnitude():
    left, right = np.full(60, 4.0), np.full(60, -3.0)  # ahead, as on the Cuadriga
    run = parse(motors(left, right))
    assert run.repairs == {"currents_as_magnitudes": 1}
    np.testing.assert_allclose(run.current_a, 7.0)
    np.testing.assert_allclose(parse(motors(left, right), currents="signed").current_a, 1.0)
    shuttle = np.where(np.arange(60) < 30, 5.0, -5.0)  # the sign of the direction: ahead and back again
    np.testing.assert_allclose(parse(motors(shuttle, shuttle)).current_a, 10.0)


def test_wheel_speeds_give_a_current_the_sign_of_power():
    ahead = np.where(np.arange(60) < 40, 1.0, -1.0)  # ahead, and back again
    wheels = {f"wheel_{side}_rad_s": [str(v) for v in ahead] for side in ("left", "right")}
    power = np.where(np.arange(60) % 20 < 12, 5.0, -1.0)  # of each motor: brakes at the end of every part
    mirrored = parse(motors(power * ahead, -power * ahead, **wheels))
    assert mirrored.repairs["currents_signed_by_wheels"] == 1
    np.testing.assert_allclose(mirrored.current_a, 2.0 * power)
    of_power = parse(motors(power, power, **wheels))
    assert "currents_signed_by_wheels" not in of_power.repairs
    np.testing.assert_allclose(of_power.current_a, 2.0 * power)
    with pytest.raises(InputError, match="auto, signed, magnitude"):
        parse(motors(power, power), currents="sum")


def test_a_total_current_keeps_its_sign_beside_sides():
    run = parse(log(current=["2.0"] * 30 + ["-1.0"] * 30, current_left=["1.0"] * 60))
    assert run.current_a.min() == -1.0
    assert "current_left" in run.extras


def test_power_is_taken_as_it_is():
    power = np.where(np.arange(60) < 50, 40.0, -10.0)
    column = {"power": [str(v) for v in power], "current": None}
    bare = parse(log(**column, voltage=None))
    assert bare.has_energy
    np.testing.assert_allclose(bare.drawn(), power)
    assert np.isnan(bare.current_a).all()
    with pytest.raises(RunsError, match="no current, so its charge is not known"):
        bare.drawn(charge=True)
    beside = parse(log(**column))  # 28 V
    np.testing.assert_allclose(beside.current_a, power / 28.0)
    np.testing.assert_allclose(beside.drawn(), power)
    both = parse(log(power=column["power"]))
    np.testing.assert_allclose(both.current_a, 2.0)
    np.testing.assert_allclose(both.drawn(), power)
    charging = parse(log(power=[str(-v) for v in power], current=None))
    assert charging.repairs == {"power_sign_flipped": 1}
    np.testing.assert_allclose(charging.drawn(), power)


def test_discharge_counted_negative_is_turned_round():
    run = parse(log(current=["-2.0"] * 60))
    np.testing.assert_allclose(run.current_a, 2.0)
    assert run.repairs == {"current_sign_flipped": 1}


def test_latitude_and_longitude_need_the_maps_crs():
    # UTM zone 15 north has its central meridian at 93 W (x = 500 km) and scale 0.9996 there; a degree of the
    # meridian arc around latitude 45 is 111.13 km (WGS 84)
    lat = [f"{45.0 + 5e-7 * k:.8f}" for k in range(60)]
    columns = log(x=None, y=None, lat=lat, lon=["-93.0"] * 60)
    run = parse(columns, crs="EPSG:32615")
    np.testing.assert_allclose(run.x, 500000.0, atol=1e-3)
    assert run.y[-1] - run.y[0] == pytest.approx(59 * 5e-7 * 111132 * 0.9996, rel=1e-3)
    with pytest.raises(RunsError, match=r"heightmap's CRS: give `crs`, such as EPSG:\d+, the UTM zone of these"):
        parse(columns)
    with pytest.raises(RunsError, match="EPSG:99999"):
        parse(columns, crs="EPSG:99999")


def geographic(lat, lon):
    return log(x=None, y=None, lat=[str(lat)] * 60, lon=[str(lon)] * 60)


@pytest.mark.parametrize(
    ("lat", "lon", "crs", "message"),
    [
        (-93.0, 45.0, "EPSG:32615", r"column 'lat': its values are -93, .*-90..90; with 'lat' and 'lon' exchanged"),
        (9.7, 48.1, "EPSG:25832", r"'lat' 9.7 and 'lon' 48.1, lie outside .*EPSG:25832; with 'lat' and 'lon' exchang"),
        (400.0, 45.0, "EPSG:3857", r"column 'lat': its values are 400, but degrees of lat lie within -90..90$"),
        (45.0, -9300.0, "EPSG:32615", r"column 'lon': its values are -9300, but degrees of lon lie within -360..360$"),
        (0.0, 0.0, "EPSG:32615", r"lie outside the area of the heightmap's CRS EPSG:32615$"),
    ],
)
def test_positions_that_cannot_be_on_the_map_are_refused_in_one_sentence(lat, lon, crs, message):
    with pytest.raises(RunsError, match=message):
        parse(geographic(lat, lon), crs=crs)


def test_single_fixes_that_do_not_exist_are_not_used():
    columns = geographic(45.0, -93.0)
    columns["lat"] = [f"{45.0 + 5e-7 * k:.8f}" for k in range(60)]
    columns["lat"][7], columns["lon"][7] = "91", "181"  # "not available" in many receivers
    columns["lat"][40], columns["lon"][40] = "0", "0"
    run = parse(columns, crs="EPSG:32615")
    assert run.repairs == {"blank_fixes": 2}
    assert np.flatnonzero(np.isnan(run.x)).tolist() == [7, 40]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"t,x,y,current\n", "0 rows are too few"),
        (b"t,x,y,current\n" + b"1,2,3,4\n", "1 rows are too few"),
        (b"t,x,y,current\n" + b"nan,nan,nan,nan\n" * 9, "only 0 rows have a time"),
        (
            "\n".join(["t,x,y,current,x", *(f"{k},{k},3,4,{5 * k}" for k in range(9))]).encode(),
            r"which of x, x \(2\) is its x\? Say it with a mapping, such as x=x",
        ),
        (b"t," + b"x" * 301 + b"\n" + b"1,2\n" * 9, "neither a column 'current'"),
        (bytes(range(256)) * 4, "neither a text in CSV"),
        (b"\x00" * 40, "NUL characters"),
        (text(log(x=["1e308", "-1e308"] * 30)).encode(), "no usable position"),
        (text(log(current=["9"] * 20 + ["1e200"] * 40)).encode(), "40 of 60 cells are blank"),
        (text(log(t=[f"{-k}" for k in range(60)])).encode(), "the clock was set back"),
        (text(log(t=["noon"] * 60)).encode(), "column 't', row 2: 'noon' is not a number"),
        (b"PAR1" + b"x" * 60, "not a readable Parquet file"),
    ],
)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_is_no_log_is_refused_in_words(content, message, tmp_path):
    (tmp_path / "run.csv").write_bytes(content)
    with pytest.raises(RunsError, match=message):
        read_run(tmp_path / "run.csv")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_stamps_before_zero_are_stamps_and_other_columns_may_hold_anything():
    run = parse(log(t=[f"{-3.0 + 0.1 * k:.1f}" for k in range(60)], status=["1e308"] * 60))
    assert run.t[0] == -3.0
    assert np.isnan(run.extras["status"]).all()


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (log(t=None), "no column 't'"),
        (log(x=None), "there is a position 'y' and no 'x'; its other columns"),
        (log(x=None, y=None), "neither 'x' and 'y' nor 'lat' and 'lon'"),
        (log(current=None), "neither a column 'current', nor any 'current_"),
        (log(current=["two"] * 60), "column 'current', row 2: 'two' is not a number"),
        (log(current=[""] * 60), "60 of 60 cells are blank"),
        (log(n=3), "3 rows are too few"),
        (log(x=[""] * 60), "no usable position"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_place(columns, message):
    with pytest.raises(RunsError, match=message):
        parse(columns)


def test_quoted_cells_and_empty_lines():
    columns = log(terrain=['"tall, wet grass"'] * 60)
    run = parse_run(text(columns).replace("\n", "\r\n\r\n"), name="r")
    assert len(run) == 60
    assert run.texts["terrain"][0] == "tall, wet grass"
    assert len(parse_run(text(log()).replace("\n", "\r\n\n"), name="r")) == 60


def test_broken_tables_are_refused(tmp_path):
    lines = text(log()).splitlines()
    wide = [lines[0], *(line.replace(".", ",") for line in lines[1:])]
    with pytest.raises(
        RunsError, match="row 2: 10 cells where the header has 5 columns, as in most rows: if its commas"
    ):
        parse_run("\n".join(wide), name="r")
    with pytest.raises(RunsError, match="empty"):
        parse_run("", name="r")
    with pytest.raises(RunsError, match=r"nothing\.csv"):
        read_run(tmp_path / "nothing.csv")


@given(st.lists(st.integers(0, 12), min_size=1, max_size=30))
def test_longest_increasing_against_the_slow_way(stamps):
    best = [1] * len(stamps)
    for k in range(len(stamps)):
        best[k] = 1 + max((best[j] for j in range(k) if stamps[j] < stamps[k]), default=0)
    kept = _longest_increasing(np.array(stamps, dtype=float))
    assert len(kept) == max(best)
    assert (np.diff(kept) > 0).all()
    assert (np.diff(np.array(stamps)[kept]) > 0).all()
