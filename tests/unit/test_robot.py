"""The robot and battery values."""

import math
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError, RobotError
from joulemap.model.ranges import ROBOT
from joulemap.model.robot import GRAVITY_MPS2, Robot


def test_price_is_hotel_plus_traction_with_brakes_and_regeneration() -> None:
    robot = Robot(idle_power_w=10.0, speed_mps=0.5, regeneration=0.25)
    np.testing.assert_allclose(robot.price_per_m([100.0, 0.0, -40.0]), [120.0, 20.0, 10.0])
    assert Robot(regeneration=0.0, idle_power_w=0.0).price_per_m(-40.0) == 0.0


def test_default_is_the_papers_robot() -> None:
    robot = Robot()  # 28.8 V nominal, 0.5 m/s: Wei & Isler 2022, IV-A
    assert (robot.nominal_voltage_v, robot.speed_mps) == (28.8, 0.5)
    assert robot.weight_n == pytest.approx(robot.mass_kg * GRAVITY_MPS2)


def test_toml_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text('name = "mule"\nmass_kg = 80\nspeed_mps = 1.0\n', encoding="utf-8")
    robot = Robot.from_toml(path)
    assert (robot.name, robot.mass_kg, robot.width_m) == ("mule", 80.0, Robot().width_m)
    assert Robot.from_mapping(robot.as_dict()) == robot


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mass_kg": 0.0}, "mass_kg"),
        ({"mass_kg": -3}, "mass_kg"),
        ({"speed_mps": math.nan}, "speed_mps"),
        ({"speed_mps": "fast"}, "speed_mps"),
        ({"regeneration": 1.0}, "regeneration"),
        ({"max_grade_deg": 90.0}, "max_grade_deg"),
        ({"battery_wh": True}, "battery_wh"),
        ({"name": ""}, "name"),
        ({"weight": 3.0}, "weight"),
    ],
)
def test_impossible_robots_are_refused_by_name(values: dict, words: str) -> None:
    with pytest.raises(RobotError, match=words):
        Robot.from_mapping(values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass": 30.0}, "robot.mass: unknown; did you mean mass_kg?"),
        ({"voltage": 24.0}, "robot.voltage: unknown; did you mean nominal_voltage_v?"),
        ({"Mass_kg": 30.0}, "robot.Mass_kg: unknown; did you mean mass_kg?"),
        ({"batery_wh": 24.0}, "robot.batery_wh: unknown; did you mean battery_wh?"),
        ({"mass_kg": 0}, "robot.mass_kg is 0; it must be at least 0.1 and at most 100000"),
        ({"idle_power_w": -1.0}, "robot.idle_power_w is -1.0; it must be at least 0 and at most 100000"),
        ({"speed_mps": "fast"}, "robot.speed_mps is 'fast'; it must be a number"),
    ],
)
def test_messages_say_the_value_the_limit_and_the_nearest_name(values: dict, message: str) -> None:
    with pytest.raises(RobotError) as caught:
        Robot.from_mapping(values)
    assert caught.value.message == message


def test_a_name_near_to_none_gets_the_list() -> None:
    with pytest.raises(RobotError, match=r"robot\.colour: unknown; known are name, mass_kg, .*turn_j_per_rad"):
        Robot.from_mapping({"colour": "red"})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mass_kg = ", r"robot\.toml, line 1, at its end: Invalid value"),
        ('name = "mule"\nmass_kg = 80 kg\n', r"robot\.toml, line 2, column \d+: "),
        ("[robot]\nmass_kg = 3\n", r"robot\.toml, line 1: robot\.robot: unknown; .*leave out the line \[robot\]"),
        ('name = "mule"\n\nmass = 3\n', r"robot\.toml, line 3: robot\.mass: unknown; did you mean mass_kg\?"),
        (
            'mass = 3\nname = "mule"\nvoltage = 24\n',
            r"robot\.toml, lines 1 and 3: robot\.mass: unknown; did you mean mass_kg\?; "
            r"robot\.voltage: unknown; did you mean nominal_voltage_v\?$",
        ),
        ("a = " + "[" * 100_000, "robot.toml: maximum recursion depth"),
        ("mass_kg = " + "9" * 5_000, "robot.toml: Exceeds the limit"),
        ("speed_mps = 1e-306", "robot.speed_mps is 1e-306; it must be at least 0.01"),
        ("# mass_kg\nmass_kg = -3\n", r"robot\.toml, line 2: robot\.mass_kg is -3; it must be at least 0\.1"),
    ],
)
def test_broken_files_are_refused_with_file_and_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotError, match=words):
        Robot.from_toml(path)
    with pytest.raises(RobotError) as caught:
        Robot.from_toml(tmp_path / "missing.toml")
    assert caught.value.message == f"there is no robot file {tmp_path / 'missing.toml'}"


def test_battery_has_what_lies_above_its_reserve() -> None:
    assert Battery(100.0, charge=0.5, reserve=0.2).available_j == pytest.approx(0.3 * 100.0 * 3600.0)
    assert Battery(100.0, charge=0.1, reserve=0.2).available_j < 0.0
    assert Robot(battery_wh=280.0).battery.available_j == pytest.approx(280.0 * 3600.0)
    for bad in ({"capacity_wh": 0.0}, {"capacity_wh": 1.0, "charge": 1.1}, {"capacity_wh": 1.0, "reserve": math.nan}):
        with pytest.raises(InputError, match="battery"):
            Battery(**bad)


@pytest.mark.parametrize("key", ["charge", "reserve"])
def test_a_charge_in_per_cent_is_refused_with_what_to_write(key: str) -> None:
    with pytest.raises(InputError) as caught:
        Battery(280.0, **{key: 60})
    assert caught.value.message == f"battery: {key} is 60; it lies between 0 and 1: for 60 % write 0.6"
    with pytest.raises(InputError, match=rf"{key} is -0\.1; it lies between 0 and 1$"):
        Battery(280.0, **{key: -0.1})


def test_numbers_of_numpy_are_numbers() -> None:
    assert Battery(280, charge=np.float32(0.5)).available_j == pytest.approx(0.5 * 280 * 3600)
    assert Robot(mass_kg=np.float32(50.0)).mass_kg == 50.0


def test_the_reference_gives_the_ranges() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs/reference/files.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")] for line in text.splitlines()]
    said = {row[1].strip("`"): row[3].split(" to ") for row in rows if len(row) == 7}
    for key, allowed in ROBOT.items():
        assert [float(end) for end in said[key]] == [allowed.low, allowed.high], key
