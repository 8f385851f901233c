"""Small logs and clouds that are huge inside, endless, or defined by themselves."""

from __future__ import annotations

import bz2
import io
import json
import sqlite3
import struct
import tarfile
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import laspy
import lz4.frame
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

from tests.fuzz.files import MAKERS, MAPS, RUNS, Rng, Sent, hostile

_MCAP = b"\x89MCAP0\r\n"
_CHANNEL = b"/battery"
_ENOUGH = 3_000_000_000


def _one_of(rng: Rng, numbers: list[int]) -> int:
    """One of whole numbers that are too large for NumPy."""
    return numbers[int(rng.integers(len(numbers)))]


def _text(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _record(code: int, body: bytes) -> bytes:
    return struct.pack("<BQ", code, len(body)) + body


def mcap_of_chunk(chunk: bytes, compression: bytes, size: int) -> bytes:
    """A recording of one chunk, which is cut off behind it."""
    head = _record(0x01, _text(b"ros2") + _text(b"tests"))
    body = struct.pack("<QQQI", 0, 1, size, 0) + _text(compression) + struct.pack("<Q", len(chunk)) + chunk
    return _MCAP + head + _record(0x06, body)


@cache
def _zeros(packer: str) -> bytes:
    """Gigabytes of zeros in kilobytes or megabytes; bzip2 packs slowly."""
    block = bytes(10_000_000)
    if packer == "zstd":
        packing = zstandard.ZstdCompressor().compressobj(size=_ENOUGH)
        return b"".join(packing.compress(block) for _ in range(_ENOUGH // len(block))) + packing.flush()
    if packer == "lz4":
        with lz4.frame.LZ4FrameCompressor() as packing:
            parts = [packing.begin(), *(packing.compress(block) for _ in range(_ENOUGH // len(block))), packing.flush()]
        return b"".join(parts)
    packing = bz2.BZ2Compressor()
    return b"".join(packing.compress(block) for _ in range(30)) + packing.flush()


@hostile
def chunk_that_unpacks_to_gigabytes(rng: Rng) -> Sent:
    packer = str(rng.choice(["zstd", "lz4"]))
    return Sent(f"MCAP chunk of zeros, {packer}", RUNS, mcap_of_chunk(_zeros(packer), packer.encode(), 1_000))


@hostile
def chunk_of_any_declared_size(rng: Rng) -> Sent:
    size = _one_of(rng, [2**31, 2**40, 2**63, 2**64 - 1])
    return Sent("MCAP chunk that declares exabytes", RUNS, mcap_of_chunk(zstandard.compress(b"x"), b"zstd", size))


@hostile
def bag_that_unpacks_to_gigabytes(rng: Rng) -> Sent:
    def _header(**fields: bytes) -> bytes:
        return _text(b"".join(_text(key.encode() + b"=" + value) for key, value in fields.items()))

    packed = _zeros("bz2")
    chunk_at = 4_117
    top = b"#ROSBAG V2.0\n"
    chunk = _header(op=b"\x05", compression=b"bz2", size=struct.pack("<I", 1_000)) + _text(packed)
    index = _header(op=b"\x04", ver=struct.pack("<I", 1), conn=bytes(4), count=struct.pack("<I", 1)) + _text(bytes(12))
    connection = _header(op=b"\x07", conn=bytes(4), topic=_CHANNEL) + _header(
        topic=_CHANNEL, type=b"sensor_msgs/BatteryState", md5sum=b"x", message_definition=b"float32 voltage"
    )
    info = _header(
        op=b"\x06",
        ver=struct.pack("<I", 1),
        chunk_pos=struct.pack("<Q", chunk_at),
        start_time=bytes(8),
        end_time=bytes(8),
        count=struct.pack("<I", 1),
    ) + _text(bytes(4) + struct.pack("<I", 1))
    at = struct.pack("<Q", chunk_at + len(chunk) + len(index))
    one = struct.pack("<I", 1)
    bag = _header(op=b"\x03", index_pos=at, conn_count=one, chunk_count=one)
    bag += _text(b" " * (chunk_at - len(top) - len(bag) - 4))
    return Sent("ROS 1 bag with a chunk of zeros", RUNS, top + bag + chunk + index + connection + info)


@hostile
def archive_of_gigabytes(rng: Rng) -> Sent:
    out = io.BytesIO()
    if rng.random() < 0.5:
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for number in range(int(rng.integers(1, 4))):
                archive.writestr(f"../bag_{number}.db3", bytes(200_000_000))
        return Sent("zip of bags of zeros", RUNS, out.getvalue())
    with tarfile.open(fileobj=out, mode="w") as archive:
        member = tarfile.TarInfo("/etc/bag_0.mcap")
        member.size = _one_of(rng, [10, 2**33, 2**60])
        archive.addfile(member, io.BytesIO(bytes(10)) if member.size == 10 else None)
    return Sent("tar with any size", RUNS, out.getvalue())


@hostile
def archive_of_many(rng: Rng) -> Sent:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number in range(20_000):
            archive.writestr(f"bag_{number}.mcap", b"")
    return Sent("zip of 20,000 bags", RUNS, out.getvalue())


@hostile
def endless_view(rng: Rng) -> Sent:
    """A database whose table of messages is computed, and never ends."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "a.db3"
        with sqlite3.connect(place) as bag:
            bag.execute("CREATE TABLE topics (id, name, type, serialization_format, offered_qos_profiles)")
            bag.execute("INSERT INTO topics VALUES (1, '/b', 'sensor_msgs/msg/BatteryState', 'cdr', '')")
            rows = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT"
            data = str(rng.choice(["zeroblob(60000000)", "x'00'", "k"]))
            wanted = "WHERE k < 0" if rng.random() < 0.5 else ""
            bag.execute(
                f"CREATE VIEW messages AS {rows} k AS id, 1 AS topic_id, k AS timestamp, {data} AS data FROM n {wanted}"
            )
        bag.close()
        return Sent("ROS 2 bag whose messages are computed for ever", RUNS, place.read_bytes())


@hostile
def types_that_hold_themselves(rng: Rng) -> Sent:
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    deep = "".join(
        f"sensor_msgs/T{k} x\n{'=' * 80}\nMSG: sensor_msgs/T{k}\n" for k in range(int(rng.integers(50, 3_000)))
    )
    texts = [
        "sensor_msgs/BatteryState again\nfloat32 voltage",
        "a/B b\n" + "=" * 80 + "\nMSG: a/B\nsensor_msgs/BatteryState c",
        deep + "float32 voltage",
        "float32[1000000000] voltage",
        "float32 " + "v" * 1_000_000,
    ]
    kind = "sensor_msgs/msg/BatteryState"
    schema = writer.register_schema(kind, "ros2msg", texts[int(rng.integers(len(texts)))].encode())
    channel = writer.register_channel("/battery", "cdr", schema)
    for k in range(20):
        writer.add_message(channel, k, b"\0\1\0\0" + b"\xff" * 400, k)
    writer.finish()
    return Sent("ROS type that holds itself", RUNS, out.getvalue())


@hostile
def deep_json(rng: Rng) -> Sent:
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    schema = writer.register_schema("sensor_msgs/BatteryState", "jsonschema", b"{}")
    channel = writer.register_channel("/battery", "json", schema)
    bodies = [
        b'{"voltage":' + b"[" * 100_000 + b"]" * 100_000 + b"}",
        b'{"voltage":' + b'{"a":' * 50_000 + b"1" + b"}" * 50_001,
        json.dumps({"voltage": {f"k{k}": k for k in range(200_000)}}).encode(),
        b'{"voltage":1' + b"0" * 100_000 + b',"header":{"stamp":{"sec":"x"}}}',
        b'"voltage"',
    ]
    for k in range(20):
        writer.add_message(channel, k, bodies[int(rng.integers(len(bodies)))], k)
    writer.finish()
    return Sent("JSON of any depth in MCAP", RUNS, out.getvalue())


@hostile
def ulog_that_holds_itself(rng: Rng) -> Sent:
    def _message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<Hc", len(body), kind) + body

    formats = [
        [b"battery_status:uint64_t timestamp;battery_status again;"],
        [b"battery_status:uint64_t timestamp;inner x;", b"inner:battery_status y;"],
        [b"battery_status:uint64_t timestamp;float[2000000000] voltage_v;"],
        [b"battery_status:uint64_t timestamp;" + b"".join(b"i%d x%d;" % (k, k) for k in range(2_000))],
    ]
    out = b"ULog\x01\x12\x35\x01" + bytes(8) + _message(b"B", bytes(40))
    out += b"".join(_message(b"F", text) for text in formats[int(rng.integers(len(formats)))])
    out += _message(b"A", struct.pack("<BH", 0, 0) + b"battery_status")
    out += b"".join(_message(b"D", struct.pack("<HQf", 0, k, 24.0)) for k in range(50))
    return Sent("ULog whose format holds itself", RUNS, out)


@hostile
def ulog_of_nothing(rng: Rng) -> Sent:
    message = [b"\0\0D", b"\2\0O\0\0", b"\2\0D\0\0"][int(rng.integers(3))]
    out = b"ULog\x01\x12\x35\x01" + bytes(8) + b"\x28\0B" + bytes(40) + message * 10_000_000
    return Sent("ULog of millions of empty messages", RUNS, out)


@hostile
def dataflash_of_any_format(rng: Rng) -> Sent:
    def _format(number: int, length: int, name: bytes, codes: bytes, columns: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, length, name, codes, columns)

    out = _format(0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    length = _one_of(rng, [0, 1, 2, 3, 11, 255])
    for number in range(int(rng.integers(1, 200))):
        out += _format(number, length, b"BAT", b"QBff", b"TimeUS,Inst,Volt,Curr")
    out += b"\xa3\x95" * 100_000
    return Sent("dataflash log whose messages have no length", RUNS, out)


@hostile
def telemetry_of_nothing(rng: Rng) -> Sent:
    stamp = struct.pack(">Q", 1_700_000_000_000_000)
    body = [b"\xfd" * 2_000_000, (b"\xfe" + bytes(7)) * 200_000, rng.bytes(1_000_000)][int(rng.integers(3))]
    return Sent("telemetry log of marks", RUNS, stamp + b"\xfd\x09\0\0" + body)


@hostile
def fit_of_many_fields(rng: Rng) -> Sent:
    body = b"".join(bytes([0x60 | k, 0, 0, 20, 0, 255]) + bytes([253, 255, 2]) * 255 + b"\xff" for k in range(16))
    body += bytes([0]) * int(rng.integers(1_000, 500_000))
    head = struct.pack("<BBHI4s", 14, 0x20, 2132, _one_of(rng, [len(body), 2**32 - 1]), b".FIT") + bytes(2)
    return Sent("FIT file of many fields", RUNS, head + body + bytes(2))


@hostile
def cloud_of_any_count(rng: Rng) -> Sent:
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.x, cloud.y, cloud.z = (rng.random(500) for _ in range(3))
    out = io.BytesIO()
    cloud.write(out, do_compress=bool(rng.random() < 0.7))
    content = bytearray(out.getvalue())
    at = _one_of(rng, [94, 96, 100, 105, 107, 131, 179, 187, 235, 243, 247])
    content[at : at + 8] = struct.pack("<Q", _one_of(rng, [2**20, 2**31, 2**40, 2**62, 2**64 - 1]))
    return Sent(
        "point cloud of any count and place", MAPS, bytes(content), {"resolution_m": float(rng.choice([1, 1e-4]))}
    )


@hostile
def far_points(rng: Rng) -> Sent:
    row = str(rng.choice(["1e308 0 0", "-1e300 1e300 5", "1e15 1e-15 0", "nan 0 0", "0 0 1e308"]))
    content = "".join(f"{k} {k % 7} 1.0\n" for k in range(500)) + row + "\n"
    return Sent("XYZ of points far apart", MAPS, content.encode(), {"name": "a.xyz"})


@hostile
def grid_map_of_any_size(rng: Rng) -> Sent:
    from tests.reference import ros_maps

    topic, kind, message = ros_maps.grid_map(np.zeros((4, 4)), (0.0, 0.0), float(rng.choice([1e-300, 1e300, 0.5])))
    for dim in message.data[0].layout.dim:
        dim.size = _one_of(rng, [0, 2, 4, 2**31, 2**32 - 1])
    return Sent("grid map of any size", MAPS, ros_maps.recording([(topic, kind, message)]))


@hostile
def cut_log(rng: Rng) -> Sent:
    """A log of any kind, cut off anywhere."""
    from tests.fuzz import recordings

    kind = str(rng.choice(list(recordings.WRITERS)))
    content = recordings.logs(kind)[0]
    return Sent(f"{kind} cut off", RUNS, content[: int(rng.integers(1, len(content)))])


@hostile
def long_tail(rng: Rng) -> Sent:
    """A good log, and then 50 MB that are none."""
    from tests.fuzz import recordings

    kind = str(rng.choice(["tlog", "ulg", "bin"]))
    how = str(rng.choice(["zeros", "noise", "marks", "specks"]))
    mark = {"tlog": b"\xfe\0", "ulg": b"\x2f\x73\x13\x20\x25\x0c\xbb\x12", "bin": b"\xa3\x95"}[kind]
    part = {"zeros": bytes(1_000), "noise": rng.bytes(50_000_000), "marks": mark, "specks": bytes(200) + rng.bytes(3)}
    tail = part[how] * (50_000_000 // len(part[how]))
    return Sent(f"{kind} with a tail of {how}", RUNS, recordings.logs(kind)[0] + tail)


BOMBS = tuple(make for make in MAKERS if make.__module__ == __name__)
"""Those of this module."""
