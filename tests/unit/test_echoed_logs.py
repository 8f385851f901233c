"""Messages as ROS prints them, wheels that turn, logs without a time or without movement."""

import json
import math
import zipfile

import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import RunsError
from joulemap.service.cli import app

ROWS = 300
T = 0.2 * np.arange(ROWS)
SPEED = 0.8 * np.sin(np.pi * T / T[-1]) ** 2
HEADING = 0.5 * np.sin(T / 9)
TURN = np.gradient(HEADING, T)
VOLTS, AMPS = 25.0 - 0.1 * SPEED, 1.5 + 3.0 * SPEED


def integral(values):
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(T)))


METRES, JOULES = integral(SPEED), integral(VOLTS * AMPS)
FAR = np.append(0.0, np.cumsum(0.5 * (SPEED[1:] + SPEED[:-1]) * np.diff(T)))
X, Y = (np.append(0.0, np.cumsum(np.diff(FAR) * way(0.5 * (HEADING[1:] + HEADING[:-1])))) for way in (np.cos, np.sin))
RADIUS, TRACK, TICKS = 0.165, 0.5, 4096
LEFT, RIGHT = SPEED - TURN * TRACK / 2, SPEED + TURN * TRACK / 2


def read(tmp_path, name, text, *mapping):
    """The run, or the words of its refusal."""
    file = tmp_path / name
    if isinstance(text, dict):
        with zipfile.ZipFile(file, "w") as archive:
            for each, content in text.items():
                archive.writestr(each, content)
    else:
        file.write_text(text)
    try:
        return jm.read_runs(file, crs="EPSG:32632", mapping=mapping or None).runs[0]
    except RunsError as error:
        return str(error)


def as_it_was(run, share=0.01):
    assert not isinstance(run, str), run
    known = np.isfinite(run.x)
    assert np.hypot(np.diff(run.x[known]), np.diff(run.y[known])).sum() == pytest.approx(METRES, rel=share)
    assert run.energy()[0] == pytest.approx(JOULES, rel=share)
    return run


def refused(said, *words):
    assert isinstance(said, str)
    for each in words:
        assert each in said


def table(**columns):
    rows = "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in zip(*columns.values(), strict=True))
    return ",".join(columns).replace("__", " ") + "\n" + rows


def stamp(k):
    whole = 1_700_000_000 + int(T[k])
    return whole, int(round(1e9 * (T[k] % 1.0)))


def odometry_yaml(k):
    sec, nanosec = stamp(k)
    covariance = "  covariance:\n" + "  - 0.0\n" * 36
    return (
        f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {nanosec}\n  frame_id: odom\nchild_frame_id: base\n"
        f"pose:\n  pose:\n    position:\n      x: {X[k]}\n      y: {Y[k]}\n      z: 0.0\n{covariance}"
        f"twist:\n  twist:\n    linear:\n      x: {SPEED[k]}\n      y: 0.0\n{covariance}---\n"
    )


def battery_yaml(k):
    sec, nanosec = stamp(k)
    return (
        f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {nanosec}\n  frame_id: ''\nvoltage: {VOLTS[k]}\n"
        f"temperature: .nan\ncurrent: {-AMPS[k]}\npresent: true\ncell_voltage: []\nlocation: ''\n---\n"
    )


def test_topics_that_ros_prints_in_yaml_are_one_log_in_one_file_or_in_two(tmp_path):
    odometry = "".join(map(odometry_yaml, range(ROWS)))
    battery = "".join(map(battery_yaml, range(0, ROWS, 2)))
    as_it_was(read(tmp_path, "both.yaml", odometry + battery))
    as_it_was(read(tmp_path, "two.zip", {"odometry.yaml": odometry, "battery.yaml": battery}))
    as_it_was(read(tmp_path, "cut.yaml", (battery + odometry)[:-200]))  # ended by Ctrl-C
    refused(read(tmp_path, "odometry.yaml", odometry), "neither a column 'current'", "current=batt_current_mA:mA")
    refused(read(tmp_path, "battery.yaml", battery), "nor a speed or a distance")
    refused(read(tmp_path, "deep.yaml", "a:\n" + "".join(" " * k + "b:\n" for k in range(1, 40)) + "c: 1\n"), "12 deep")


def test_yaml_is_imported_with_its_heading(tmp_path):
    (tmp_path / "drive.yaml").write_text("".join(f(k) for k in range(ROWS) for f in (odometry_yaml, battery_yaml)))
    out = tmp_path / "answer.json"
    found = CliRunner().invoke(app, ["import", str(tmp_path / "drive.yaml"), "--json", str(out)])
    assert found.exit_code == 0, found.output
    (run,) = json.loads(out.read_text())["runs"]
    assert run["format"] == "YAML text"
    assert (run["metres"], run["energy_j"]) == pytest.approx((METRES, JOULES), rel=0.01)


def test_topics_that_ros_prints_as_rows_without_a_header_are_one_log(tmp_path):
    def _row(*cells):
        return ",".join(map(str, cells)) + "\n"

    none = ["nan"]
    turned = [(0.0, 0.0, math.sin(h / 2), math.cos(h / 2)) for h in HEADING]
    odometry = "".join(
        _row(*stamp(k), "odom", "base", X[k], Y[k], 0.0, *turned[k], *[0.0] * 36, SPEED[k], *[0.0] * 5, *[0.0] * 36)
        for k in range(ROWS)
    )
    battery = "".join(
        _row(*stamp(k), "", VOLTS[k], *none, -AMPS[k], *none * 3, 0.8, 2, 1, 2, True, 3.6, 3.6, "", "")
        for k in range(ROWS)
    )
    as_it_was(read(tmp_path, "two.zip", {"odometry.csv": odometry, "battery.csv": battery}))
    refused(read(tmp_path, "other.csv", "".join(_row(*stamp(k), 1.0, 2.0) for k in range(ROWS))), "write a line with")


def test_a_yaml_document_with_a_list_of_records(tmp_path):
    records = "".join(
        f"- time: {t}\n  speed_mps: {v}\n  power_w: {p}\n" for t, v, p in zip(T, SPEED, VOLTS * AMPS, strict=True)
    )
    as_it_was(read(tmp_path, "samples.yaml", f"robot: r7\nsamples:\n{records}"))


def test_json_behind_a_stamp_and_a_topic_and_lines_with_units_after_remarks(tmp_path):
    lines = "".join(
        f"{1700000000 + t:.3f} rover/state {json.dumps({'speed_mps': v, 'battery': {'volt_V': u, 'curr_A': i}})}\n"
        for t, v, u, i in zip(T, SPEED, VOLTS, AMPS, strict=True)
    )
    as_it_was(read(tmp_path, "mosquitto.txt", lines))
    lines = "".join(
        f"{1.7e12 + 1000 * t:.0f},rover/{n},{w}\n"
        for t, v, p in zip(T, SPEED, VOLTS * AMPS, strict=True)
        for n, w in (("speed_ms", v), ("power_w", p))
    )
    as_it_was(read(tmp_path, "topics.csv", f"timestamp,topic,payload\n{lines}"))
    other = lines.replace("speed_ms", "mood")
    refused(read(tmp_path, "other.csv", f"timestamp,topic,payload\n{other}"), "nor a speed or a distance")
    lines = "".join(
        f"t={1000 * t:.0f}ms v={v:.5f}m/s U={u:.4f}V I={i:.4f}A\n"
        for t, v, u, i in zip(T, SPEED, VOLTS, AMPS, strict=True)
    )
    as_it_was(read(tmp_path, "serial.txt", f"Booting...\nINA226 ok\n{lines}"))


def test_the_speed_of_a_vehicle_is_the_mean_of_its_sides(tmp_path):
    power = {"power_w": VOLTS * AMPS}
    sides = as_it_was(read(tmp_path, "sides.csv", table(t=T, v_left_mps=LEFT, v_right_mps=RIGHT, **power)))
    assert sides.reading["distance"] == "the sum of the mean of v_left_mps [m/s] and v_right_mps [m/s]"
    own = table(t=T, speed_left=LEFT, speed_right=RIGHT, **power)
    as_it_was(read(tmp_path, "own.csv", own))
    slip = table(t=T, speed_left=2 * LEFT, speed_right=2 * RIGHT, radar_mps=SPEED, **power)
    as_it_was(read(tmp_path, "slip.csv", slip, "speed=radar_mps:m/s"))  # what is said wins
    unsaid = read(tmp_path, "unsaid.csv", table(t=T, velL=LEFT, velR=RIGHT, **power))
    refused(unsaid, "say the unit of its wheel speeds", "like speed_left=velL:m/s")


@pytest.mark.parametrize(
    ("left", "right", "unit"),
    [
        ("wheel_left_velocity_rad_s", "wheel_right_velocity_rad_s", 1.0),
        ("Left__wheel__(rpm)", "Right__wheel__(rpm)", 60 / math.tau),
        ("left_rpm", "right_rpm", 60 / math.tau),
        ("Drehzahl__links__[U/min]", "Drehzahl__rechts__[U/min]", 60 / math.tau),
        ("/joint_states/front_left_wheel_joint/velocity", "/joint_states/front_right_wheel_joint/velocity", 1.0),
    ],
)
def test_wheels_that_turn_need_their_radius(tmp_path, left, right, unit):
    text = table(t=T, **{left: unit * LEFT / RADIUS, right: unit * RIGHT / RADIUS}, power_w=VOLTS * AMPS)
    refused(read(tmp_path, "turn.csv", text), "say how fast its wheels turn", "wheel_radius_m=0.165")
    as_it_was(read(tmp_path, "turn.csv", text, f"wheel_radius_m={RADIUS}"))


def test_wheels_that_are_mounted_the_other_way_round_need_their_sign(tmp_path):
    text = table(t=T, left_wheel_mps=LEFT, right_wheel_mps=-RIGHT, power_w=VOLTS * AMPS)
    refused(read(tmp_path, "signs.csv", text), "which counts backward", "speed_right=-velR:m/s")
    as_it_was(read(tmp_path, "signs.csv", text, "speed_left=left_wheel_mps", "speed_right=-right_wheel_mps"))
    text = table(t=T, left_wheel_rpm=LEFT, right_wheel_rpm=-RIGHT, power_w=VOLTS * AMPS)
    said = read(tmp_path, "signs.csv", text, "wheel_radius_m=0.1")
    refused(said, "of opposite signs", "such as wheel_right_rad_s=-right_wheel_rpm")


def test_ticks_of_wheels_need_the_way_of_a_tick(tmp_path):
    left, right = (
        np.round((FAR + side * TRACK / 2 * (HEADING - HEADING[0])) / (math.tau * RADIUS) * TICKS) for side in (-1, 1)
    )
    text = table(t=T, left_ticks=left, right_ticks=right, power_w=VOLTS * AMPS)
    refused(read(tmp_path, "ticks.csv", text), "distance=left_ticks+right_ticks:0.00015")
    as_it_was(read(tmp_path, "ticks.csv", text, f"distance=left_ticks+right_ticks:{math.pi * RADIUS / TICKS}"))


def test_a_log_without_a_time_is_read_once_a_row_is_said_to_last(tmp_path):
    text = table(V=VOLTS, A=AMPS, Speed__kmh=3.6 * SPEED)
    refused(read(tmp_path, "rows.csv", text), "there is no column 't'", "row_s=0.5")
    as_it_was(read(tmp_path, "rows.csv", text, "row_s=0.2"))


def test_a_component_of_a_vector_is_no_speed(tmp_path):
    columns = {"navVel[0]": 100 * SPEED * np.cos(HEADING), "navVel[1]": 100 * SPEED * np.sin(HEADING)}
    text = table(t=T, **columns, **{"navPos[0]": 100 * X, "navPos[1]": 100 * Y}, power_w=VOLTS * AMPS)
    refused(read(tmp_path, "inav.csv", text), "nor a speed or a distance")
    as_it_was(read(tmp_path, "inav.csv", text, "x=navPos[0]:cm", "y=navPos[1]:cm"))


def test_a_speed_beside_stamps_of_ros_is_in_metres_per_second_and_that_is_said(tmp_path):
    sec, nanosec = (np.array([stamp(k)[part] for k in range(ROWS)], dtype=float) for part in (0, 1))
    stamps = {"header.stamp.sec": sec, "header.stamp.nanosec": nanosec}
    run = as_it_was(read(tmp_path, "ros.csv", table(**stamps, linear_velocity=SPEED, power_w=VOLTS * AMPS)))
    assert any("taken for m/s, the unit of ROS" in note for note in run.notes)
    twist = {"twist.linear.x": SPEED, "twist.angular.z": TURN}
    as_it_was(read(tmp_path, "twist.csv", table(**stamps, **twist, power_w=VOLTS * AMPS)))
    commanded = {"cmd_vel.twist.linear.x": SPEED}
    refused(read(tmp_path, "cmd.csv", table(**stamps, **commanded, power_w=VOLTS * AMPS)), "nor a speed or a distance")


def test_a_log_of_a_vehicle_at_rest_is_refused(tmp_path):
    placed = table(t=T, lat=0 * T + 48.2, lon=0 * T + 11.5, speed_kmh=0 * T, charge_power_kw=-11.0 + 0 * T)
    refused(read(tmp_path, "charging.csv", placed), "it does not move: its position is the same in every row")
