"""One drive in every format is the same run; topics by type and by name; missing libraries."""

import builtins

import numpy as np
import pytest

from joulemap.model.errors import RunsError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.model.runs.segments import Segments
from tests.reference import log_files as files


@pytest.fixture(scope="module")
def drive():
    return files.drive()


@pytest.fixture(scope="module")
def written(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    found = {
        "bag": files.write_bag(folder / "drive.bag", drive),
        "db3": files.write_db3(folder / "drive.db3", drive),
        "mcap": files.write_mcap(folder / "drive.mcap", drive),
        "bin": files.write_dataflash(folder / "drive.bin", drive),
        "tlog": files.write_tlog(folder / "drive.tlog", drive),
        "ulg": files.write_ulog(folder / "drive.ulg", drive),
        "fit": files.write_fit(folder / "drive.fit", drive),
    }
    return found | {path.stem: path for path in files.write_csvs(folder, drive)}


@pytest.fixture(scope="module")
def plain(drive) -> Segments:
    columns = {"t": drive.t, "x": drive.x, "y": drive.y, "voltage": drive.voltage, "current": drive.current}
    rows = zip(*columns.values(), strict=True)
    run = parse_run("\n".join([",".join(columns), *(",".join(map(repr, map(float, row))) for row in rows)]), name="r")
    return cut_segments(run)


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap", "bin", "tlog", "ulg", "fit", "milli", "german", "feet"])
def test_a_drive_is_the_same_segments_in_every_format(kind, written, plain):
    run = read_run(written[kind], crs=files.CRS, mapping=files.FEET if kind == "feet" else None)
    segments = cut_segments(run)
    assert len(segments) == len(plain)
    assert segments.energy_j.sum() == pytest.approx(plain.energy_j.sum(), rel=0.001)
    assert segments.driven_m.sum() == pytest.approx(plain.driven_m.sum(), rel=0.001)
    np.testing.assert_allclose(segments.energy_j / segments.driven_m, plain.energy_j / plain.driven_m, rtol=0.05)
    assert np.hypot(segments.x - plain.x, segments.y - plain.y).max() < 0.2
    assert run.reading


def test_the_answer_says_what_was_taken_and_from_where(written):
    assert read_run(written["mcap"], crs=files.CRS).reading == {
        "t": "stamps of the messages [s]",
        "voltage": "/battery_state.voltage [V]",
        "current": "/battery_state.current [A]",
        "lat": "/fix.latitude [deg]",
        "lon": "/fix.longitude [deg]",
        "z": "/fix.altitude [m] (or /odom.pose.pose.position.z)",
        "heading": "/odom.heading [deg]",
        "roll": "/odom.roll [deg]",
        "pitch": "/odom.pitch [deg]",
        "speed": "/odom.twist.twist.linear.x [m/s]",
    }


def test_a_topic_is_overridden_and_headings_are_those_of_the_map(written, drive, plain):
    mapping = {"x": "/odom.pose.pose.position.x", "y": "/odom.pose.pose.position.y"}
    run = read_run(written["bag"], mapping=mapping)  # without a CRS
    assert "lat" not in run.reading
    np.testing.assert_allclose(run.extras["heading"][:-10], drive.heading[: len(run) - 10], atol=0.01)
    assert cut_segments(run).energy_j.sum() == pytest.approx(plain.energy_j.sum(), rel=0.01)
    with pytest.raises(RunsError, match=r"no column of it; near it are /battery_state.current"):
        read_run(written["mcap"], crs=files.CRS, mapping={"current": "/battery_state.curent:A"})


def test_streams_without_a_common_time_are_refused(drive, tmp_path):
    from joulemap.model.runs.formats.messages import Collector
    from joulemap.model.runs.formats.ros import ros_log
    from joulemap.model.runs.logs import _table
    from joulemap.model.runs.table import LIMITS

    collector = Collector("r", LIMITS)
    for k in range(50):
        collector.add("/battery", 0.1 * k, {"voltage": 24.0, "current": 2.0})
        collector.add("/fix", 100.0 + 0.1 * k, {"latitude": 36.7, "longitude": -4.4})
    kinds = {"/battery": "sensor_msgs/BatteryState", "/fix": "sensor_msgs/NavSatFix"}
    with pytest.raises(RunsError, match="not logged at the same time"):
        _table(ros_log(collector.streams(), kinds), {}, "r", LIMITS, {})
    del kinds["/battery"]
    with pytest.raises(RunsError, match=r"no message with a current or a power was found \(in /battery, /fix\)"):
        _table(ros_log(collector.streams(), kinds), {}, "r", LIMITS, {})


def test_a_pause_of_a_topic_is_a_gap_and_not_a_straight_line():
    from joulemap.model.runs.common_rows import at_stamps

    t = np.arange(0.0, 20.0, 0.5)
    stamps = np.concatenate([np.arange(0.0, 5.1, 0.1), np.arange(12.0, 20.0, 0.1)])
    found = at_stamps(t, stamps, stamps, turning=False)
    assert np.isnan(found[(t > 5.01) & (t < 11.99)]).all()
    np.testing.assert_allclose(found[t <= 5.0], t[t <= 5.0])
    turned = at_stamps(np.array([0.5]), np.array([0.0, 1.0]), np.array([350.0, 20.0]), turning=True)
    np.testing.assert_allclose(turned, [5.0])


@pytest.mark.parametrize("kind", ["bag", "mcap", "bin", "tlog", "ulg", "fit"])
def test_a_missing_library_is_named_with_what_to_install(kind, written, monkeypatch):
    import sys

    libraries = ("rosbags", "mcap", "pymavlink", "pyulog", "fitdecode")
    for name in [name for name in sys.modules if name.split(".")[0] in libraries]:
        monkeypatch.delitem(sys.modules, name)
    usual = builtins.__import__

    def _without(name, *args, **kwargs):
        if name.split(".")[0] in libraries:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name.split(".")[0])
        return usual(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", _without)
    with pytest.raises(RunsError, match=r"is not installed: pip install 'joulemap\[logs\]'"):
        read_run(written[kind], crs=files.CRS)
