"""Recordings of several files, in Protobuf, or in an encoding that is not read; archives that unpack to too much."""

import io
import tarfile
import zipfile

import lz4.frame
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from joulemap.model.errors import InputError, RunsError, TooLargeError
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.service.library.run_files import find_run_files, read_runs
from tests.fuzz import bombs
from tests.reference import log_files as files


@pytest.fixture(scope="module")
def drive():
    return files.drive(8.0)


@pytest.fixture(scope="module")
def whole(drive, tmp_path_factory):
    path = files.write_db3(tmp_path_factory.mktemp("whole") / "a.db3", drive)
    return parse_run(path, name="run", crs=files.CRS)


def split_bag(folder, drive, suffix, parts=3):
    """A bag as `ros2 bag record --max-bag-duration` leaves it, but that its metadata.yaml names one part only."""
    folder.mkdir()
    messages = list(files._ros_messages(drive, ros1=False))
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    for number, chosen in enumerate(np.array_split(np.arange(len(messages)), parts)):
        part = folder / f"part{number}"
        with BagWriter(part, version=9, storage_plugin=plugin) as bag:
            connections = {}
            for topic, kind, ns, data, store in (messages[k] for k in chosen):
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=store)
                bag.write(connections[topic], ns, data)
        (part / f"part{number}{suffix}").rename(folder / f"bag_{number}{suffix}")
        (part / "metadata.yaml").rename(folder / "metadata.yaml")
        part.rmdir()
    return folder


def archive_of(folder, kind):
    out = io.BytesIO()
    if kind == "zip":
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(folder.iterdir()):
                archive.write(path, f"site/{path.name}")
    else:
        with tarfile.open(fileobj=out, mode="w:gz" if kind == "tar.gz" else "w") as archive:
            archive.add(folder, "site")
    return out.getvalue()


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_bag_of_several_files_is_one_run(drive, whole, suffix, tmp_path):
    folder = split_bag(tmp_path / "monday", drive, suffix)
    for place in (folder, folder / "metadata.yaml"):
        run = read_run(place, crs=files.CRS)
        np.testing.assert_allclose(run.t, whole.t, atol=1e-6)
        np.testing.assert_allclose(run.drawn(), whole.drawn(), rtol=1e-9)
    assert find_run_files(tmp_path, trial=False) == [folder]
    if suffix == ".db3":
        assert len(read_runs(tmp_path, crs=files.CRS)) == 1
    for kind in ("zip", "tar", "tar.gz"):
        run = parse_run(archive_of(folder, kind), name=f"monday.{kind}", crs=files.CRS)
        np.testing.assert_allclose(run.drawn(), whole.drawn(), rtol=1e-9)


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_compressed_bags_are_the_same(drive, whole, compression, tmp_path):
    run = read_run(files.write_bag(tmp_path / "a.bag", drive, compression=compression), crs=files.CRS)
    np.testing.assert_allclose(run.drawn(), whole.drawn(), rtol=1e-9)


@pytest.mark.parametrize("compression", ["LZ4", "NONE"])
def test_compressed_recordings_are_the_same(drive, whole, compression, tmp_path):
    run = read_run(files.write_mcap(tmp_path / "a.mcap", drive, compression=compression), crs=files.CRS)
    np.testing.assert_allclose(run.drawn(), whole.drawn(), rtol=1e-9)


def test_a_chunk_that_unpacks_to_more_than_it_declares_is_not_unpacked():
    with pytest.raises(RunsError, match=r"the chunk at byte 34 declares 1,000 bytes, and holds more or less"):
        parse_run(bombs.mcap_of_chunk(lz4.frame.compress(bytes(10_000_000)), b"lz4", 1_000), name="a.mcap")
    with pytest.raises(TooLargeError, match=r"the chunk at byte 34 .* unpacks to 1,099,511,627,776 bytes"):
        parse_run(bombs.mcap_of_chunk(b"", b"zstd", 2**40), name="a.mcap")


def test_archives_that_hold_no_bag_say_what_they_hold(drive, tmp_path):
    folder = split_bag(tmp_path / "monday", drive, ".db3", parts=1)
    (folder / "bag_0.db3").rename(folder / "bag_0.db3.zstd")
    with pytest.raises(InputError, match=r"bag_0\.db3\.zstd is compressed: unpack it \(`zstd -d bag_0\.db3\.zstd`\)"):
        read_run(folder, crs=files.CRS)
    with pytest.raises(InputError, match="is compressed"):
        parse_run(archive_of(folder, "zip"), name="a.zip")
    (folder / "bag_0.db3.zstd").unlink()
    with pytest.raises(InputError, match=r"holds no \.mcap, \.db3, \.bag file: it holds metadata\.yaml"):
        read_run(folder, crs=files.CRS)
    with pytest.raises(InputError, match=r"send the folder with its \.db3 or \.mcap files as one \.zip"):
        parse_run((folder / "metadata.yaml").read_bytes(), name="metadata.yaml")


def test_archives_that_unpack_to_too_much_are_refused_before_they_do():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bag_0.mcap", bytes(60_000_000))
    with pytest.raises(TooLargeError, match=r"unpacks to 1 files of 60,000,000 bytes or more, the limits are 1,000"):
        parse_run(out.getvalue(), name="a.zip")


def _protobuf(package, name, fields, itself=0):
    """A message class made from its definition, and the definition as MCAP has it."""
    file = FileDescriptorProto(name=f"{name}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, field in enumerate(fields, start=1):
        message.field.add(
            name=field, number=number, type=FieldDescriptorProto.TYPE_DOUBLE, label=FieldDescriptorProto.LABEL_OPTIONAL
        )
    for number in range(itself):
        message.field.add(
            name=f"inner_{number}",
            number=100 + number,
            type=FieldDescriptorProto.TYPE_MESSAGE,
            type_name=f".{package}.{name}",
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
    pool = DescriptorPool()
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}"))
    return made, FileDescriptorSet(file=[file]).SerializeToString()


def _recorded(drive, encoding="protobuf"):
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    fix, fix_text = _protobuf("foxglove", "LocationFix", ["latitude", "longitude", "altitude"])
    pack, pack_text = _protobuf("rover", "Pack", ["volts", "amps"], itself=30)
    channels = [
        writer.register_channel(topic, encoding, writer.register_schema(kind, "protobuf", text))
        for topic, kind, text in (("/fix", "foxglove.LocationFix", fix_text), ("/pack", "rover.Pack", pack_text))
    ]
    for k, t in enumerate(drive.t):
        ns = round((files.EPOCH_S + t) * 1e9)
        place = fix(latitude=drive.lat[k], longitude=drive.lon[k], altitude=50.0)
        battery = pack(volts=drive.voltage[k], amps=drive.current[k])
        for channel, message in zip(channels, (place, battery), strict=True):
            writer.add_message(channel, ns, message.SerializeToString(), ns)
    writer.finish()
    return out.getvalue()


def test_protobuf_messages_are_read_by_their_own_definitions(drive, whole):
    mapping = {"voltage": "/pack.volts", "current": "/pack.amps"}
    run = parse_run(_recorded(drive), name="a.mcap", crs=files.CRS, mapping=mapping)
    np.testing.assert_allclose(run.drawn(), drive.power, rtol=1e-6)
    assert np.hypot(run.x - whole.x, run.y - whole.y).max() < 0.01


def test_an_encoding_that_is_not_read_is_named(drive):
    with pytest.raises(RunsError, match=r"in flatbuffer, which is not read: record them in CDR, ROS 1, JSON or Proto"):
        parse_run(_recorded(drive, "flatbuffer"), name="a.mcap")
