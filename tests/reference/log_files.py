"""One simulated drive, written by each format's own library where there is one, else from its specification."""

from __future__ import annotations

import io
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import Transformer

from joulemap.model.runs.table import FloatArray

CRS = "EPSG:32630"
EPOCH_S = 1_700_000_000.0


@dataclass(frozen=True)
class Drive:
    """Time [s], place in the CRS [m] and on Earth [deg], battery, and where the robot points [deg]."""

    t: FloatArray
    x: FloatArray
    y: FloatArray
    lat: FloatArray
    lon: FloatArray
    voltage: FloatArray
    current: FloatArray
    heading: FloatArray

    @property
    def power(self) -> FloatArray:
        return self.voltage * self.current


def drive(seconds: float = 140.0, rate_hz: float = 10.0) -> Drive:
    """A gentle curve at half a metre per second, with a load that changes slowly, as on rolling ground."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    heading = 40.0 + 35.0 * np.sin(t / 23.0)
    step = 0.5 * np.diff(t, prepend=t[0])
    x = 366_950.0 + np.cumsum(step * np.sin(np.radians(heading)))
    y = 4_064_300.0 + np.cumsum(step * np.cos(np.radians(heading)))
    lon, lat = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(x, y)
    current = 6.0 + 3.0 * np.sin(t / 17.0)
    return Drive(t, x, y, lat, lon, 26.0 - 0.02 * current, current, heading)


def _quaternion(heading_deg: float) -> tuple[float, float]:
    """z and w of a yaw counted from east to north."""
    yaw = np.radians(90.0 - heading_deg)
    return float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


def _ros_messages(d: Drive, *, ros1: bool):
    """Topic, type, stamp [ns] and serialised message, in the order of time; the battery is slower than the fixes."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = store.types
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr

    def _header(k: int, frame: str):
        ns = int(round((EPOCH_S + d.t[k]) * 1e9))
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        number = {"seq": k} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **number)

    def _zeros(kind: str, **given):
        fields = store.fielddefs[kind][1]
        made = {}
        for name, (node, inner) in fields:
            if name in given:
                made[name] = given[name]
            elif int(node) == 2:
                made[name] = _zeros(inner)
            elif int(node) == 1:
                made[name] = "" if inner[0] == "string" else (inner[0] == "bool" and False) or 0
            elif int(node) == 3:
                made[name] = np.zeros(inner[1])
            else:
                made[name] = np.zeros(0)
        return types[kind](**made)

    for k in range(d.t.size):
        ns = int(round((EPOCH_S + d.t[k] + 0.003) * 1e9))  # recorded three milliseconds after it was sent
        fix = _zeros(
            "sensor_msgs/msg/NavSatFix",
            header=_header(k, "gps"),
            latitude=float(d.lat[k]),
            longitude=float(d.lon[k]),
            altitude=50.0,
        )
        yield "/fix", "sensor_msgs/msg/NavSatFix", ns, serialize(fix, "sensor_msgs/msg/NavSatFix"), store
        z, w = _quaternion(float(d.heading[k]))
        q = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=z, w=w)
        p = types["geometry_msgs/msg/Point"](x=float(d.x[k] - d.x[0]), y=float(d.y[k] - d.y[0]), z=0.0)
        pose = _zeros(
            "geometry_msgs/msg/PoseWithCovariance", pose=types["geometry_msgs/msg/Pose"](position=p, orientation=q)
        )
        odometry = _zeros("nav_msgs/msg/Odometry", header=_header(k, "odom"), pose=pose)
        yield "/odom", "nav_msgs/msg/Odometry", ns, serialize(odometry, "nav_msgs/msg/Odometry"), store
        if k % 2 == 0:
            battery = _zeros(
                "sensor_msgs/msg/BatteryState",
                header=_header(k, "base"),
                voltage=float(d.voltage[k]),
                current=-float(d.current[k]),  # negative when discharging, as the message defines it
            )
            kind = "sensor_msgs/msg/BatteryState"
            yield "/battery_state", kind, ns, serialize(battery, kind), store


def write_bag(path: Path, d: Drive, *, compression: str = "") -> Path:
    from rosbags.rosbag1 import Writer

    bag = Writer(path)
    if compression:
        bag.set_compression(Writer.CompressionFormat[compression])
    with bag:
        connections: dict[str, object] = {}
        for topic, kind, ns, data, store in _ros_messages(d, ros1=True):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, data)
    return path


def write_db3(path: Path, d: Drive) -> Path:
    import shutil

    from rosbags.rosbag2 import Writer

    folder = path.with_suffix("")
    with Writer(folder, version=9) as bag:
        connections: dict[str, object] = {}
        for topic, kind, ns, data, store in _ros_messages(d, ros1=False):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, data)
    shutil.move(next(folder.glob("*.db3")), path)
    return path


def write_mcap(path: Path, d: Drive, *, compression: str = "ZSTD") -> Path:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        mcap = Writer(stream, compression=CompressionType[compression], chunk_size=64 * 1024)
        mcap.start("ros2", "joulemap tests")
        channels: dict[str, int] = {}
        for topic, kind, ns, data, store in _ros_messages(d, ros1=False):
            if topic not in channels:
                text, _ = store.generate_msgdef(kind, ros_version=2)
                schema = mcap.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = mcap.register_channel(topic, "cdr", schema)
            mcap.add_message(channels[topic], ns, bytes(data), ns)
        mcap.finish()
    return path


def write_dataflash(path: Path, d: Drive) -> Path:
    """ArduPilot's format: ardupilot.org/copter/docs/common-logs.html and AP_Logger/LogStructure.h."""
    out = io.BytesIO()

    def _format(number: int, name: str, codes: str, columns: str) -> struct.Struct:
        kinds = {"Q": "Q", "f": "f", "L": "i", "B": "B", "b": "b", "I": "I", "H": "H", "c": "h", "C": "H", "n": "4s"}
        body = struct.Struct("<" + "".join({"N": "16s", "Z": "64s", **kinds}[code] for code in codes))
        out.write(b"\xa3\x95\x80")
        out.write(struct.pack("<BB4s16s64s", number, body.size + 3, name.encode(), codes.encode(), columns.encode()))
        return body

    _format(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    gps = _format(1, "GPS", "QBBIHBcLLffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U")
    battery = _format(2, "BAT", "QBff", "TimeUS,Inst,Volt,Curr")
    position = _format(3, "POS", "QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt")
    attitude = _format(4, "ATT", "Qccccccff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw")
    for k in range(d.t.size):
        us = int(round(d.t[k] * 1e6)) + 5_000_000
        lat, lon = round(float(d.lat[k]) * 1e7), round(float(d.lon[k]) * 1e7)
        if k % 2 == 0:
            fields = (us, 0, 3, 1000 * k, 2300, 12, 80, lat, lon, 50.0, 0.5, 0.0, 0.0, 1)
            out.write(b"\xa3\x95\x01" + gps.pack(*fields))
        out.write(b"\xa3\x95\x02" + battery.pack(us, 0, float(d.voltage[k]), float(d.current[k])))
        out.write(b"\xa3\x95\x03" + position.pack(us, lat, lon, 50.0, 0.0))
        yaw = round(float(d.heading[k]) * 100)
        out.write(b"\xa3\x95\x04" + attitude.pack(us, 0, 0, 0, 0, 0, yaw, 0.0, 0.0))
    path.write_bytes(out.getvalue())
    return path


def write_tlog(path: Path, d: Drive) -> Path:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as stream:
        for k in range(d.t.size):
            us = int(round((EPOCH_S + d.t[k]) * 1e6))
            lat, lon = round(float(d.lat[k]) * 1e7), round(float(d.lon[k]) * 1e7)
            ms = round(1000 * float(d.t[k]))
            place = mavlink.MAVLink_global_position_int_message(ms, lat, lon, 50_000, 0, 0, 0, 0, 0)
            volts = [round(1000 * float(d.voltage[k]))] + [65535] * 9
            amps = round(100 * float(d.current[k]))
            battery = mavlink.MAVLink_battery_status_message(0, 0, 0, 32767, volts, amps, 0, 0, 80)
            for message in (place, battery):
                stream.write(struct.pack(">Q", us) + message.pack(mav))
    return path


def write_ulog(path: Path, d: Drive) -> Path:
    """PX4's format: docs.px4.io/main/en/dev_log/ulog_file_format.html."""
    out = io.BytesIO()

    def _message(kind: bytes, body: bytes) -> None:
        out.write(struct.pack("<Hc", len(body), kind) + body)

    out.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000))
    _message(b"B", bytes(40))
    _message(b"F", b"battery_status:uint64_t timestamp;float voltage_v;float current_a;")
    _message(b"F", b"vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;uint8_t[4] _padding0;")
    _message(b"A", struct.pack("<BH", 0, 0) + b"battery_status")
    _message(b"A", struct.pack("<BH", 0, 1) + b"vehicle_global_position")
    for k in range(d.t.size):
        us = int(round(d.t[k] * 1e6)) + 5_000_000
        _message(b"D", struct.pack("<HQff", 0, us, float(d.voltage[k]), float(d.current[k])))
        _message(b"D", struct.pack("<HQddf", 1, us, float(d.lat[k]), float(d.lon[k]), 50.0))
    path.write_bytes(out.getvalue())
    return path


_CRC = (0x0000, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401)
_CRC += (0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400)


def _fit_crc(data: bytes) -> int:
    crc = 0
    for byte in data:
        for part in (byte & 0xF, byte >> 4):
            crc = ((crc >> 4) & 0x0FFF) ^ _CRC[crc & 0xF] ^ _CRC[part]
    return crc


def write_fit(path: Path, d: Drive) -> Path:
    """Garmin's format, Flexible and Interoperable Data Transfer Protocol (D00001275): one record each second."""
    body = io.BytesIO()

    def _definition(local: int, message: int, fields: list[tuple[int, int, int]]) -> None:
        body.write(bytes([0x40 | local, 0, 0]) + struct.pack("<HB", message, len(fields)))
        for field in fields:
            body.write(bytes(field))

    _definition(0, 0, [(0, 1, 0x00), (1, 2, 0x84), (4, 4, 0x86)])  # file_id: type, manufacturer, time_created
    began = int(EPOCH_S) - 631_065_600  # FIT counts from 1989-12-31
    body.write(bytes([0]) + struct.pack("<BHI", 4, 255, began))
    _definition(1, 20, [(253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (7, 2, 0x84)])
    for k in range(d.t.size):
        if abs(d.t[k] - round(d.t[k])) > 1e-6:
            continue
        turns = 2**31 / 180.0
        record = (began + round(d.t[k]), round(d.lat[k] * turns), round(d.lon[k] * turns), round(d.power[k]))
        body.write(bytes([1]) + struct.pack("<IiiH", *record))
    data = body.getvalue()
    header = struct.pack("<BBHI4s", 14, 0x20, 2132, len(data), b".FIT")
    header += struct.pack("<H", _fit_crc(header))
    path.write_bytes(header + data + struct.pack("<H", _fit_crc(header + data)))
    return path


def write_csvs(folder: Path, d: Drive) -> list[Path]:
    """Three odd ones: milliseconds and milliamperes, German text with ISO times, and power in feet beside a date."""
    ms = [
        f"{1000 * (EPOCH_S + t):.0f},{lat:.9f},{lon:.9f},{1000 * amps:.1f},{volts:.4f}"
        for t, lat, lon, amps, volts in zip(d.t, d.lat, d.lon, d.current, d.voltage, strict=True)
    ]
    first = folder / "milli.csv"
    first.write_text("\n".join(["timestamp_ms,latitude,longitude,batt_current_mA,batt_voltage_V", *ms]) + "\n")
    german = []
    for t, x, y, amps, volts in zip(d.t, d.x, d.y, d.current, d.voltage, strict=True):
        whole = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(EPOCH_S + t + 1e-6))
        stamp = f"{whole}.{round(1000 * (t % 1)) % 1000:03d}Z"
        cells = (f"{x:.4f}", f"{y:.4f}", f"{-amps:.5f}", f"{volts:.4f}")
        german.append(";".join([stamp, *(cell.replace(".", ",") for cell in cells)]))
    second = folder / "german.csv"
    second.write_text("\n".join(["Time;Easting;Northing;Battery Current [A];Battery Voltage [V]", *german]) + "\n")
    feet = [
        f"{t / 60:.7f}\t{x / 0.3048:.4f}\t{y / 0.3048:.4f}\t{p / 1000:.7f}"
        for t, x, y, p in zip(d.t, d.x, d.y, d.power, strict=True)
    ]
    third = folder / "feet.tsv"
    third.write_text("\n".join(["minutes\teast_ft\tnorth_ft\tdraw_kW", *feet]) + "\n")
    return [first, second, third]


FEET = {"t": "minutes:min", "x": "east_ft", "y": "north_ft", "power": "draw_kW"}
"""What the third of these needs said."""


def main() -> None:
    """Print the energy of the drive in each format beside that of the drive itself."""
    import tempfile

    from joulemap.model.runs.cutting import cut_segments
    from joulemap.model.runs.reader import read_run

    d = drive()
    true = float(np.trapezoid(d.power, d.t))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written = [
            write_bag(folder / "drive.bag", d),
            write_db3(folder / "drive.db3", d),
            write_mcap(folder / "drive.mcap", d),
            write_dataflash(folder / "drive.bin", d),
            write_tlog(folder / "drive.tlog", d),
            write_ulog(folder / "drive.ulg", d),
            write_fit(folder / "drive.fit", d),
            *write_csvs(folder, d),
        ]
        print(f"{'file':12} segments  metres   energy [J]  beside the drive")
        for path in written:
            found = cut_segments(read_run(path, crs=CRS, mapping=FEET if path.suffix == ".tsv" else None))
            energy = float(found.energy_j.sum())
            row = f"{path.name:12} {len(found):8} {found.driven_m.sum():8.2f} {energy:11.1f}"
            print(f"{row}  {100 * (energy / true - 1):+.3f} %")


if __name__ == "__main__":
    main()
