"""Logs that were cut off or changed are read or refused in words, in bounded time and memory, with nothing printed."""

import struct
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import fitdecode
import numpy as np
import pytest

from joulemap.model.errors import JoulemapError, RunsError, TooLargeError
from joulemap.model.runs.kalman import Sensors, smooth
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.table import TableLimits
from joulemap.service.library.heightmaps import read_heightmap
from tests.fuzz.bombs import BOMBS
from tests.fuzz.files import MAPS
from tests.fuzz.inputs import changed
from tests.fuzz.recordings import LIMITS, WRITERS
from tests.reference import log_files as files


def _read_all(kind, folder, truncated, mutated, capfd):
    good = WRITERS[kind](folder / f"drive.{kind}", files.drive(20.0)).read_bytes()
    parse_run(good, name="run", crs=files.CRS, limits=LIMITS)  # compiles what is timed
    rng = np.random.default_rng(5)
    inputs = [good[: int(len(good) * (k + 0.5) / truncated)] for k in range(truncated)]
    inputs += [changed(rng, good, text=False) for _ in range(mutated)]
    said: list[JoulemapError] = []
    for number, content in enumerate(inputs):
        began = time.process_time()
        try:
            parse_run(content, name="run", crs=files.CRS, limits=LIMITS)
        except JoulemapError as error:
            said.append(error)
        assert time.process_time() - began < 10.0, f"{kind} number {number}"
    assert said or kind in CUT
    assert all(isinstance(error, RunsError | TooLargeError) for error in said)
    assert all(error.message.startswith(("run run", "run: ")) for error in said)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", WRITERS)
def test_broken_logs_are_read_or_refused_in_words(kind, tmp_path, capfd):
    _read_all(kind, tmp_path, 4, 8, capfd)


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_many_broken_logs_are_read_or_refused_in_words(kind, tmp_path, capfd):
    _read_all(kind, tmp_path, 20, 60, capfd)


CUT = {
    "mcap": "in the middle of a record that begins at byte",
    "bin": "in the middle of a record that begins at byte",
    "tlog": "in the middle of a record that begins at byte",
    "ulg": "in the middle of a record that begins at byte",
    "fit": "it ends",
    "bag": "in the middle of a record that begins at byte",
}


@pytest.mark.parametrize("kind", CUT)
def test_of_a_log_that_was_cut_off_the_whole_records_are_kept_with_a_note(kind, tmp_path):
    content = WRITERS[kind](tmp_path / f"a.{kind}", files.drive(20.0)).read_bytes()
    whole = parse_run(content, name="run", crs=files.CRS)
    assert whole.notes == ()
    cut = parse_run(content[: int(0.6 * len(content))], name="run", crs=files.CRS)
    (note,) = cut.notes
    assert "was cut off" in note
    assert CUT[kind] in note
    assert 0.4 * len(whole) < len(cut) < 0.8 * len(whole)
    np.testing.assert_allclose(cut.drawn(), whole.drawn()[: len(cut)], rtol=1e-9)


@pytest.mark.parametrize("fill", [b"\0", b"\xff"])
@pytest.mark.parametrize("kind", ["tlog", "ulg", "bin"])
def test_room_that_was_taken_and_never_written_ends_a_log_with_a_note(kind, fill, tmp_path):
    """As of a memory card whose robot lost its power: all that was written is read, within the time of that."""
    content = WRITERS[kind](tmp_path / f"a.{kind}", files.drive(20.0)).read_bytes()
    whole = parse_run(content, name="run", crs=files.CRS)
    began = time.process_time()
    found = parse_run(content + fill * 50_000_000, name="run", crs=files.CRS)
    assert time.process_time() - began < 5.0
    (note,) = found.notes
    words = "zeros" if fill == b"\0" else "bytes of 255"
    assert f"was not closed: from byte {len(content):,} to its end at {len(content) + 50_000_000:,} it holds " in note
    assert f"nothing but {words}. What comes before is kept" in note
    np.testing.assert_array_equal(found.drawn(), whole.drawn())
    cut = content[: int(0.6 * len(content))]
    torn = parse_run(cut + fill * 100_000, name="run", crs=files.CRS)
    assert 0.4 * len(whole) < len(torn) < 0.8 * len(whole)
    assert len(torn) - len(parse_run(cut, name="run", crs=files.CRS)) in (0, 1)  # the record that was begun


@pytest.mark.parametrize("kind", ["tlog", "ulg", "bin"])
def test_a_few_zeros_at_the_end_take_no_record_away(kind, tmp_path):
    """The last record may end with zeros itself."""
    content = WRITERS[kind](tmp_path / f"a.{kind}", files.drive(20.0)).read_bytes()
    whole = parse_run(content, name="run", crs=files.CRS)
    for more in (1, 7, 8, 9, 300, 600):
        np.testing.assert_array_equal(
            parse_run(content + bytes(more), name="run", crs=files.CRS).drawn(), whole.drawn()
        )


@pytest.mark.parametrize("kind", ["tlog", "ulg"])
def test_a_long_tail_of_noise_is_refused_soon(kind, tmp_path):
    content = WRITERS[kind](tmp_path / f"a.{kind}", files.drive(20.0)).read_bytes()
    for part in (np.random.default_rng(1).bytes(20_000_000), (bytes(200) + b"abc") * 100_000):
        began = time.process_time()
        with pytest.raises(RunsError, match=r"run run: the .* is (truncated or )?corrupt (after|at)"):
            parse_run(content + part, name="run", crs=files.CRS)
        assert time.process_time() - began < 8.0


@pytest.mark.parametrize(
    ("formats", "words"),
    [
        (["battery_status:uint64_t timestamp;cell[2] held;", "cell:battery_status back;"], "holds itself"),
        (["battery_status:uint64_t timestamp;a[90] x;", "a:b[90] x;", "b:float[90] x;"], "has 729,001 columns"),
        (["battery_status:uint64_t timestamp;float[" + "9" * 5_000 + "] x;"], "1,000,000,000 columns, the limit is"),
    ],
)
def test_a_message_of_messages_is_refused_before_it_is_written_out(formats, words, tmp_path):
    content = files.write_ulog(tmp_path / "a.ulg", files.drive(5.0)).read_bytes()
    own = b"battery_status:uint64_t timestamp;float voltage_v;float current_a;"
    at = content.index(own)
    made = b"".join(struct.pack("<Hc", len(text), b"F") + text.encode() for text in formats)
    with pytest.raises(JoulemapError, match=words):
        parse_run(content[: at - 3] + made + content[at + len(own) :], name="run", crs=files.CRS)


def test_a_recording_without_its_summary_has_all_its_messages(tmp_path):
    content = files.write_mcap(tmp_path / "a.mcap", files.drive(20.0)).read_bytes()
    run = parse_run(content[:-100], name="run", crs=files.CRS)
    assert run.notes == ("the MCAP recording was cut off in its index. All its messages are there",)
    assert len(run) == 201


def test_a_bag_that_was_not_closed_is_read_without_its_index(tmp_path):
    content = bytearray(files.write_bag(tmp_path / "a.bag", files.drive(20.0), compression="LZ4").read_bytes())
    whole = parse_run(bytes(content), name="run", crs=files.CRS)
    at = content.index(b"index_pos=") + len(b"index_pos=")
    content[at : at + 8] = bytes(8)
    run = parse_run(bytes(content), name="run", crs=files.CRS)
    assert run.notes == ("the ROS 1 bag was not closed and has no index: it was read from start to end",)
    np.testing.assert_array_equal(run.drawn(), whole.drawn())
    np.testing.assert_array_equal(run.x, whole.x)


def test_a_database_that_was_cut_off_says_where_and_how_to_repair_it(tmp_path):
    content = files.write_db3(tmp_path / "a.db3", files.drive(20.0)).read_bytes()
    with pytest.raises(RunsError, match=r"ends at byte 126,976 of 253,952\. `sqlite3 BAG .recover \| sqlite3 OUT`"):
        parse_run(content[: len(content) // 2], name="run", crs=files.CRS)


@pytest.mark.parametrize("make", [make for make in BOMBS if "gigabytes" not in make.__name__])
def test_what_is_huge_inside_endless_or_defined_by_itself_is_refused_soon(make, capfd):
    for seed in range(2):
        sent = make(np.random.default_rng(seed))
        began = time.process_time()
        try:
            if sent.to == MAPS:
                read_heightmap(sent.content, filename=sent.params.pop("name", "map"), max_cells=10**6, **sent.params)
            else:
                parse_run(sent.content, name="run", crs=files.CRS, limits=LIMITS)
        except JoulemapError as error:
            said = error.message
        else:
            said = ""
        assert len(said) < 1_000
        assert time.process_time() - began < 10.0
    assert capfd.readouterr() == ("", "")


def test_messages_without_a_length_do_not_hold_the_reader_up(tmp_path):
    content = files.write_dataflash(tmp_path / "a.bin", files.drive(5.0)).read_bytes()
    at = content.index(b"\xa3\x95\x80\x02") + 4  # the length in the format of BAT
    with pytest.raises(RunsError, match=r"corrupt at byte [\d,]+ of [\d,]+: a message has no length"):
        parse_run(content[:at] + b"\0" + content[at + 1 :], name="run", crs=files.CRS)


def test_more_messages_than_the_limit_are_too_many(tmp_path):
    path = files.write_tlog(tmp_path / "a.tlog", files.drive(20.0))
    with pytest.raises(TooLargeError, match=r"more than 50 messages of .* split it"):
        parse_run(path, name="run", crs=files.CRS, limits=TableLimits(rows=50))


def test_threads_that_read_at_once_leave_the_standard_streams_to_the_others(tmp_path, monkeypatch, capsys):
    content = files.write_fit(tmp_path / "drive.fit", files.drive(20.0)).read_bytes()
    both_read, first_ended = threading.Barrier(3), threading.Event()

    class Complaining(fitdecode.FitReader):
        def __enter__(self):
            print("a complaint")
            both_read.wait(60)
            if threading.current_thread().name.endswith("_1"):
                first_ended.wait(60)
            return super().__enter__()

    monkeypatch.setattr(fitdecode, "FitReader", Complaining)
    before = sys.stdout, sys.stderr

    def _read():
        parse_run(content, name="run", crs=files.CRS, limits=LIMITS)
        first_ended.set()

    with ThreadPoolExecutor(2) as pool:
        reads = [pool.submit(_read), pool.submit(_read)]
        both_read.wait(60)
        for line in range(300):  # more than complaints of one file may be
            print(line)
        for read in reads:
            read.result()
    assert (sys.stdout, sys.stderr) == before
    assert capsys.readouterr().out == "".join(f"{line}\n" for line in range(300))


def test_a_stamp_of_a_wrong_clock_does_not_fill_a_million_rows():
    rows = ["t,speed,power,distance", *(f"{k},{1 + k % 2},{50 + k},{1.5 * k}" for k in range(6)), "1.7e9,2,70,9"]
    assert len(parse_run("\n".join(rows) + "\n", name="run")) <= 7


def test_positions_without_noise_are_smoothed():
    t = np.arange(7.0)
    values = 0.5 + 0.2 * np.sin(0.3 * t)[None]
    sensors = Sensors(t, t == 0, values, np.full((1, 7), 1e-14), np.ones((1, 7)), np.array([False]))
    assert np.isfinite(smooth(sensors, np.zeros(1), 1e-14).rate).all()
